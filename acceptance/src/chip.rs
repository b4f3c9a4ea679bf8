//! A chip's device and revision, as it reports them (DBGMCU_IDCODE).
//!
//! Level 1 reads it from the self-test image, levels 2 and 3 from every robot (object 0x2001:6).

/// The devices of the boards that the firmware is built for, by DEV_ID (RM0390 33.6.1, RM0090
/// 38.6.1, RM0008 31.6.1).
const DEVICES: [(u32, &str); 3] = [
    (0x421, "STM32F446"),
    (0x413, "STM32F405/407"),
    (0x414, "STM32F103, high density"),
];

/// Device and revision in words: `STM32F446, revision 0x1000`. The maker's errata sheets name the
/// revisions by these numbers.
#[must_use]
pub fn describe(id_code: u32) -> String {
    let (device, revision) = (id_code & 0xFFF, id_code >> 16);
    let known = DEVICES.iter().find(|(number, _)| *number == device);
    match (id_code, known) {
        // An STM32F103 without a debugger, by its revision, or no chip at all.
        (0, _) => "not told by the chip".to_owned(),
        (_, Some((_, name))) => format!("{name}, revision {revision:#06X}"),
        (_, None) => format!("device {device:#05X}, revision {revision:#06X}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_has_its_name_and_its_revision() {
        assert_eq!(describe(0x1000_6421), "STM32F446, revision 0x1000");
        assert_eq!(describe(0x100F_6413), "STM32F405/407, revision 0x100F");
        assert_eq!(describe(0x2000_6411), "device 0x411, revision 0x2000");
        assert_eq!(describe(0), "not told by the chip");
    }
}
