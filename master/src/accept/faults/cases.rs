//! How each cause of docs/safety.md is brought about, or why it is not.

/// How a cause is brought about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Means {
    /// The master's heartbeat stops; setpoints and SYNC go on.
    Heartbeat,
    /// SYNC stops, and all else: the master is killed.
    Killed,
    /// Setpoints stop.
    Setpoints,
    /// A second master sends setpoints of its own.
    Second,
    /// Setpoints are no numbers.
    NotANumber,
    /// A boot-up message with the watched robot's number.
    Double,
    /// A wheel's encoder is declared reversed.
    Reversed,
    /// One member has another group parameter.
    Plan,
    /// One member's configuration contradicts itself.
    Inconsistent,
    /// A hand raises the supply, and hardly any more is allowed meanwhile.
    TooHigh,
    /// A hand pulls the encoder of the front left wheel.
    Encoder,
    /// A hand pulls the CAN connector.
    Bus,
    /// A hand pulls the drivers' fault line.
    Driver,
    /// A hand presses the emergency stop.
    Stop,
    /// A hand opens the protective stop.
    Protective,
    /// A hand lowers the supply.
    Supply,
    /// It is tried as part of this other cause.
    With(u8),
    /// It is not tried, for this reason.
    Not(&'static str),
}

const LEVEL_ONE: &str = "it needs a program that fails; level 1 measures it as watchdog.*";
const NO_TIME: &str = "docs/safety.md promises no time for it, and it needs a load on the floor";
const DRIVES: &str = "it needs smart drives, and this group has bridges";

/// How each row of docs/safety.md is tried.
pub const CASES: &[(u8, Means)] = &[
    (1, Means::Heartbeat),
    (2, Means::Killed),
    (3, Means::Setpoints),
    (4, Means::Bus),
    (5, Means::With(15)),
    (
        6,
        Means::Not("a frame that one member alone misses cannot be made by hand"),
    ),
    (7, Means::Second),
    (8, Means::NotANumber),
    (
        9,
        Means::Not(
            "while the bus is shorted SYNC is missed first (2); level 1 measures it as can.recovery",
        ),
    ),
    (
        10,
        Means::Not("a master cannot send more frames than the controller holds"),
    ),
    (11, Means::Encoder),
    (12, Means::Reversed),
    (13, Means::Not("a driven wheel must not be held by hand")),
    (14, Means::Driver),
    (15, Means::Stop),
    (16, Means::Supply),
    (17, Means::Not(LEVEL_ONE)),
    (18, Means::Not(LEVEL_ONE)),
    (19, Means::Not(LEVEL_ONE)),
    (20, Means::Not(LEVEL_ONE)),
    (
        21,
        Means::Not("power would have to fail within 3 ms of a save"),
    ),
    (22, Means::Not("it would have to damage what is stored")),
    (23, Means::Inconsistent),
    (24, Means::Not(NO_TIME)),
    (25, Means::Not(NO_TIME)),
    (26, Means::TooHigh),
    (27, Means::Plan),
    (28, Means::Double),
    (29, Means::Protective),
    (
        30,
        Means::Not("the crystal is soldered; level 1 compares it as clock.crystal"),
    ),
    (31, Means::Not("the processor's supply is the board's own")),
    (32, Means::Not("it would have to draw too large a current")),
    (34, Means::Not("docs/safety.md promises no time for it")),
    (35, Means::Not(DRIVES)),
    (36, Means::Not(DRIVES)),
    (37, Means::Not(DRIVES)),
    (38, Means::Not(DRIVES)),
];

#[cfg(test)]
mod tests {
    use acceptance::causes;
    use acceptance::promise::{ACCEPTANCE, SAFETY};

    use super::*;

    /// docs/acceptance.md has a table of what is left out.
    #[test]
    fn every_cause_that_is_not_tried_is_on_the_page() {
        let rows: Vec<(u8, &str)> = ACCEPTANCE
            .text
            .lines()
            .skip_while(|line| !line.starts_with("| cause | what it is |"))
            .skip(2)
            .map_while(|line| {
                let mut cells = line.strip_prefix('|')?.split('|').map(str::trim);
                Some((cells.next()?.parse().ok()?, cells.nth(1)?))
            })
            .collect();
        let here: Vec<(u8, &str)> = CASES
            .iter()
            .filter_map(|(number, means)| match means {
                Means::Not(reason) => Some((*number, *reason)),
                _ => None,
            })
            .collect();
        assert_eq!(rows, here);
    }

    #[test]
    fn every_cause_of_the_page_is_tried_or_has_its_reason() {
        let page: Vec<u8> = causes::read(SAFETY.text)
            .unwrap()
            .iter()
            .map(|promise| promise.number)
            .collect();
        let here: Vec<u8> = CASES.iter().map(|case| case.0).collect();
        let mut sorted = page.clone();
        sorted.sort_unstable();
        assert_eq!(here, sorted);
    }
}
