//! The names of frames.

/// What a frame is, for people: `GroupTwist`, `MemberStatus 3`, `SDO request 2`.
#[must_use]
pub fn frame_name(id: u16) -> String {
    let node = id & 0x7F;
    let of_node = |name: &str| format!("{name} {node}");
    match id & 0x780 {
        0x000 if node == 0 => "NMT".into(),
        0x080 if node == 0 => "SYNC".into(),
        0x080 => of_node("emergency"),
        0x180 if id == protocol::cob::GROUP_TWIST => "GroupTwist".into(),
        0x180 => of_node("MemberStatus"),
        0x200 => of_node("CommissioningTwist"),
        0x280 => of_node("MeasuredTwist"),
        0x380 => of_node("Pose"),
        0x480 => of_node("WheelRates"),
        0x500 => of_node("YawRate"),
        0x580 => of_node("SDO answer"),
        0x600 => of_node("SDO request"),
        0x700 => of_node("heartbeat"),
        0x780 if matches!(id, 0x7E4 | 0x7E5) => "LSS".into(),
        _ => "unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_the_names_of_the_protocol_page() {
        for (id, name) in [
            (0x000, "NMT"),
            (0x080, "SYNC"),
            (0x083, "emergency 3"),
            (0x181, "GroupTwist"),
            (0x191, "MemberStatus 17"),
            (0x503, "YawRate 3"),
            (0x582, "SDO answer 2"),
            (0x701, "heartbeat 1"),
            (0x7E5, "LSS"),
            (0x123, "unknown"),
        ] {
            assert_eq!(frame_name(id), name);
        }
    }
}
