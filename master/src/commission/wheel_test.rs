//! Tests whether every motor turns its own wheel in the right direction and its encoder counts it.
//!
//! One wheel at a time gets some voltage, and all four encoders are watched. This finds motors and
//! encoders that are silent, reversed or swapped. It cannot distinguish a reversed motor from a
//! reversed encoder or swapped motors from swapped encoders, and it does not detect a motor and its
//! encoder that are both reversed. With the answers of a person who looks at the wheels it finds
//! these, too, and proposes one remedy instead of two.
//!
//! Smart drives report what they turn themselves, so a drive with the identifier of another wheel
//! looks right to the robot. Only a person sees it, and the remedy is a key of the group file.
//!
//! The test ends early if the motor drivers seem to be of another kind than the one configured:
//! their wheels turn all at once, or backwards, and would do so in every further run.

use protocol::{Address, address};

use crate::bus::link::Link;
use crate::bus::wire::Wire;
use crate::commission::motors::{TURNED, Turned, WHEELS, Watch, turn_wheel};
use crate::error::MasterError;

/// Wheels need the same voltage for a rate within this share, or their encoders count differently.
const ALIKE: f32 = 0.25;

/// What a person saw turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observed {
    /// Nothing.
    Nothing,
    /// This wheel, so that the base would roll forward first (or not).
    Wheel {
        /// Which.
        wheel: usize,
        /// Forward first.
        forward: bool,
    },
}

/// The result of one wheel.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Which wheel got the voltage.
    pub wheel: usize,
    /// What the encoders counted.
    pub turned: Turned,
    /// What is wrong and what to do; empty when nothing is.
    pub problem: Option<String>,
}

/// Asks what was seen to turn, after a wheel that got the voltage, with what the encoders counted.
pub type Look<'a> = &'a mut dyn FnMut(usize, &Turned) -> Result<Option<Observed>, MasterError>;

/// Tests the wheels of one robot, configured and in PRE-OPERATIONAL with its wheels off the floor.
/// `look` returns what was seen after each wheel; `None` when no person looks. `watch` is told how
/// long each wheel takes.
///
/// # Errors
/// As [`turn_wheel`], and what `look` fails with.
pub fn test_wheels<L: Link>(
    wire: &mut Wire<L>,
    node: u8,
    period_us: u64,
    look: Look<'_>,
    watch: Watch<'_>,
) -> Result<Vec<Finding>, MasterError> {
    let mut bits = |at| Ok::<_, MasterError>(wire.read(node, at, protocol::Kind::U8)?.to_bits());
    let stage = bits(address::OUTPUT_STAGE)?;
    let mut identifiers = [0; 4];
    for (identifier, at) in identifiers.iter_mut().zip(IDENTIFIERS) {
        *identifier = bits(at)?;
    }
    let reversed = Reversed {
        encoders: bits(address::ENCODER_REVERSED)?,
        motors: bits(address::MOTOR_REVERSED)?,
    };
    let mut turned = [Turned::default(); 4];
    let mut observed = [None; 4];
    for (wheel, turned) in (0_u8..).zip(&mut turned) {
        *turned = turn_wheel(wire, node, period_us, wheel, watch)?;
        let wheel = usize::from(wheel);
        let is_smart = SMART.contains(&stage);
        let other = || other_drivers(wheel, turned, stage, &reversed);
        if let Some(problem) = (!is_smart).then(other).flatten() {
            return Ok(vec![Finding {
                wheel,
                turned: *turned,
                problem: Some(problem),
            }]);
        }
        if let Some(observed) = observed.get_mut(wheel) {
            *observed = look(wheel, turned)?;
        }
    }
    let mut findings = judge(turned, observed, &reversed);
    if SMART.contains(&stage) {
        name_wrong_drives(&mut findings, observed, identifiers);
    }
    Ok(findings)
}

/// Kinds of object 0x2027:6 that are smart drives.
const SMART: [u32; 2] = [4, 5];

/// Which smart drive is which wheel's.
const IDENTIFIERS: [Address; 4] = [
    address::DRIVE_FRONT_LEFT,
    address::DRIVE_FRONT_RIGHT,
    address::DRIVE_REAR_LEFT,
    address::DRIVE_REAR_RIGHT,
];

/// Where another wheel was seen to turn than was meant, its drive has the identifier that was
/// commanded.
fn name_wrong_drives(
    findings: &mut [Finding],
    observed: [Option<Observed>; 4],
    identifiers: [u32; 4],
) {
    let mut seen = [None; 4];
    for (observed, identifier) in observed.iter().zip(identifiers) {
        if let Some(Observed::Wheel { wheel, .. }) = observed
            && let Some(seen) = seen.get_mut(*wheel)
        {
            *seen = Some(identifier);
        }
    }
    let remedy = match seen {
        [Some(a), Some(b), Some(c), Some(d)] => format!(
            "set `drive_identifiers = [{a}, {b}, {c}, {d}]` under `[robot.motor]`, or exchange \
             the identifiers on the drives"
        ),
        _ => "test again with --ask and watch all four wheels".to_owned(),
    };
    for ((finding, observed), identifier) in findings.iter_mut().zip(observed).zip(identifiers) {
        if let Some(Observed::Wheel { wheel, .. }) = observed
            && wheel != finding.wheel
        {
            let name = WHEELS.get(wheel).copied().unwrap_or("unknown");
            finding.problem = Some(format!(
                "drive {identifier} turns the {name} wheel instead: {remedy}"
            ));
        }
    }
}

/// A problem if the drivers seem to be of another kind than object 0x2027:6.
fn other_drivers(wheel: usize, turned: &Turned, stage: u32, reversed: &Reversed) -> Option<String> {
    let name = match stage {
        0 => "PWM and direction",
        1 => "IN/IN with slow decay",
        2 => "two PWMs a wheel with fast decay",
        6 => "two PWMs a wheel with both high between the pulses",
        _ => "locked antiphase",
    };
    let kind = format!("{} = {stage}, {name}", address::OUTPUT_STAGE);
    let look = "docs/bring-up.md, Motor drivers, has the value for each driver";
    if turned.all() {
        return Some(format!(
            "all wheels turn as soon as the drivers are on: the robot is configured for {kind}, \
             but its drivers are of another kind; {look}"
        ));
    }
    let way = turned.ways.get(wheel).copied().unwrap_or(0.0);
    (stage != 0 && way < -TURNED).then(|| {
        format!(
            "it counts backwards: the robot is configured for {kind}; if its drivers are of \
             another kind, {look}; if not, {}, or {}",
            reversed.encoder(wheel),
            reversed.motor(wheel)
        )
    })
}

/// The bits of 0x2020:2 and :3 as they are.
struct Reversed {
    encoders: u32,
    motors: u32,
}

impl Reversed {
    fn encoder(&self, wheel: usize) -> String {
        format!(
            "swap A and B of its encoder, or set `encoder.directions = {}` in the robot's entry of \
             the group file",
            directions(self.encoders ^ 1 << wheel)
        )
    }

    fn motor(&self, wheel: usize) -> String {
        format!(
            "swap the wires of its motor, or set `motor.directions = {}` in the robot's entry of \
             the group file",
            directions(self.motors ^ 1 << wheel)
        )
    }
}

/// Bits of reversed wheels as a key of the group file has them.
fn directions(bits: u32) -> String {
    format!(
        "{:?}",
        [0, 1, 2, 3].map(|wheel| if bits >> wheel & 1 == 1 { -1 } else { 1 })
    )
}

fn judge(
    turned: [Turned; 4],
    observed: [Option<Observed>; 4],
    reversed: &Reversed,
) -> Vec<Finding> {
    let mut speeds: Vec<f32> = turned.iter().filter_map(|t| t.speed).collect();
    speeds.sort_by(f32::total_cmp);
    let usual = speeds
        .get(speeds.len() / 2)
        .copied()
        .filter(|_| speeds.len() > 2);
    let moved = |wheel: usize| -> Vec<usize> {
        let ways = turned.get(wheel).map_or([0.0; 4], |t| t.ways);
        let all = ways.iter().enumerate();
        all.filter(|(_, way)| way.abs() > TURNED)
            .map(|(n, _)| n)
            .collect()
    };
    let each = turned.iter().zip(observed).enumerate();
    each.map(|(wheel, (turned, observed))| {
        let way = turned.ways.get(wheel).copied().unwrap_or(0.0);
        let name = |n: usize| WHEELS.get(n).copied().unwrap_or("unknown");
        let problem = match (moved(wheel).as_slice(), observed) {
            ([], Some(Observed::Wheel { wheel: other, .. })) if other != wheel => Some(format!(
                "the motor of the {} wheel turns instead, and no encoder counts: exchange the \
                 plugs of the two motors, then test again",
                name(other)
            )),
            ([], Some(Observed::Wheel { .. })) => Some(
                "it turns, but its encoder does not count: check the encoder's plug, supply and \
                 both channels"
                    .into(),
            ),
            ([], Some(Observed::Nothing)) => Some(
                "it does not turn: check the motor's plug, the driver and its enable, and \
                 whether the wheel is blocked"
                    .into(),
            ),
            ([], None) => Some(
                "no encoder counts: if the wheel turned, check its encoder's plug, supply and \
                 both channels; if it did not, check the motor's plug, the driver, and \
                 whether the wheel is blocked"
                    .into(),
            ),
            ([one], Some(Observed::Wheel { wheel: turns, .. }))
                if *one != wheel && turns == *one =>
            {
                Some(format!(
                    "the {} wheel turns and counts instead: exchange the plugs of the two motors",
                    name(*one)
                ))
            }
            ([one], Some(Observed::Wheel { wheel: turns, .. }))
                if *one == wheel && turns != wheel =>
            {
                Some(format!(
                    "the {} wheel turns instead, and this one's encoder counts it: exchange the \
                     plugs of both, motors and encoders",
                    name(turns)
                ))
            }
            ([one], observed) if *one != wheel => {
                let (this, other) = (name(wheel), name(*one));
                let swapped = moved(*one) == [wheel];
                let remedy = if swapped {
                    format!(
                        "the two are swapped, so exchange the plugs of the {this} and the {other} \
                         wheel's encoders"
                    )
                } else {
                    format!("plug the {this} wheel's encoder in where the {other} wheel's is")
                };
                let motors = match (observed, swapped) {
                    (None, true) => ", or of their motors if the other wheel turned",
                    (None, false) => ", or do so with their motors if the other wheel turned",
                    (Some(_), _) => "",
                };
                Some(format!(
                    "the {other} wheel's encoder counts instead: {remedy}{motors}"
                ))
            }
            ([_], Some(Observed::Wheel { forward, .. })) => match (way > 0.0, forward) {
                (true, true) => unlike(turned.speed, usual),
                (false, true) => Some(format!(
                    "its encoder counts backwards: {}",
                    reversed.encoder(wheel)
                )),
                (false, false) => Some(format!("it turns backwards: {}", reversed.motor(wheel))),
                (true, false) => Some(format!(
                    "it turns backwards, and its encoder counts backwards: {}; and {}",
                    reversed.motor(wheel),
                    reversed.encoder(wheel)
                )),
            },
            ([_], Some(Observed::Nothing)) => Some(
                "its encoder counts, but you saw nothing turn: check that you are looking at \
                    this robot"
                    .into(),
            ),
            ([_], None) if way < 0.0 => Some(format!(
                "its encoder counts backwards: if the wheel rolled the base forward first, {}; if \
                 not, {}",
                reversed.encoder(wheel),
                reversed.motor(wheel)
            )),
            ([_], None) => unlike(turned.speed, usual),
            (many, _) => Some(format!(
                "{} encoders count at once ({}): look for wheels that touch each other, and for \
                 channels of different encoders in one plug",
                many.len(),
                many.iter().map(|n| name(*n)).collect::<Vec<_>>().join(", ")
            )),
        };
        Finding {
            wheel,
            turned: *turned,
            problem,
        }
    })
    .collect()
}

/// An encoder with other counts, or a motor of another kind, needs another voltage for a rate.
fn unlike(speed: Option<f32>, usual: Option<f32>) -> Option<String> {
    let (speed, usual) = (speed?, usual?);
    let ratio = usual / speed;
    ((ratio - 1.0).abs() > ALIKE).then(|| {
        format!(
            "at the same voltage it seems {ratio:.2} times as fast as the others: check its \
             encoder's counts per revolution (2020:1, 2014:5 to 2017:5), its gear, and whether \
             the wheel drags"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: Reversed = Reversed {
        encoders: 0,
        motors: 0,
    };

    fn good() -> [Turned; 4] {
        [0, 1, 2, 3].map(|n: usize| {
            let mut ways = [0.0; 4];
            ways[n] = 3.0;
            Turned {
                ways,
                speed: Some(0.8),
            }
        })
    }

    fn problems(turned: [Turned; 4], observed: [Option<Observed>; 4]) -> [Option<String>; 4] {
        let findings = judge(turned, observed, &NONE);
        [0, 1, 2, 3].map(|n: usize| findings[n].problem.clone())
    }

    fn has(problem: &Option<String>, parts: &[&str]) {
        let text = problem.as_deref().unwrap_or("no problem");
        for part in parts {
            assert!(text.contains(part), "{part:?} in {text:?}");
        }
    }

    #[test]
    fn wheels_in_order_have_no_problem() {
        assert_eq!(problems(good(), [None; 4]), [None, None, None, None]);
        let forward = [0, 1, 2, 3].map(|wheel| {
            Some(Observed::Wheel {
                wheel,
                forward: true,
            })
        });
        assert_eq!(problems(good(), forward), [None, None, None, None]);
    }

    /// The drives of the three others go round: what was commanded for the front right wheel turned
    /// the rear left one, so that one's drive has the identifier 2, and so on.
    #[test]
    fn drives_in_each_others_places_are_named_with_the_key() {
        let wheel = |wheel| {
            Some(Observed::Wheel {
                wheel,
                forward: true,
            })
        };
        let observed = [wheel(0), wheel(2), wheel(3), wheel(1)];
        let mut findings = judge(good(), observed, &NONE);
        name_wrong_drives(&mut findings, observed, [1, 2, 3, 4]);
        assert_eq!(findings[0].problem, None);
        let key = "drive_identifiers = [1, 4, 2, 3]";
        has(
            &findings[1].problem,
            &["drive 2 turns the rear left wheel", key],
        );
        has(&findings[2].problem, &["drive 3 turns the rear right", key]);
        let observed = [wheel(0), wheel(2), None, None];
        name_wrong_drives(&mut findings, observed, [1, 2, 3, 4]);
        has(&findings[1].problem, &["drive 2", "all four wheels"]);
    }

    #[test]
    fn exchanged_encoders_are_told_from_exchanged_motors_by_who_looks() {
        let mut turned = good();
        turned.swap(0, 2);
        let blind = problems(turned, [None; 4]);
        has(
            &blind[0],
            &[
                "rear left wheel's encoder counts",
                "the two are swapped",
                "encoders, or of their motors",
            ],
        );
        assert_eq!((&blind[1], &blind[3]), (&None, &None));
        let observation = |first, second| {
            let wheel = |wheel| {
                Some(Observed::Wheel {
                    wheel,
                    forward: true,
                })
            };
            problems(turned, [wheel(first), wheel(1), wheel(second), wheel(3)])
        };
        has(
            &observation(0, 2)[0],
            &["exchange the plugs of the front left and the rear left wheel's encoders"],
        );
        assert!(!observation(0, 2)[0].as_deref().unwrap().contains("motors"));
        has(
            &observation(2, 0)[0],
            &["rear left wheel turns", "plugs of the two motors"],
        );
    }

    #[test]
    fn reversed_ones_are_told_apart_by_who_looks() {
        let mut turned = good();
        turned[1].ways[1] = -0.1;
        turned[1].speed = None;
        has(
            &problems(turned, [None; 4])[1],
            &[
                "backwards",
                "encoder.directions = [1, -1, 1, 1]",
                "motor.directions = [1, -1, 1, 1]",
            ],
        );
        let observed = |forward| {
            let observed = Observed::Wheel { wheel: 1, forward };
            problems(turned, [None, Some(observed), None, None])[1].clone()
        };
        has(
            &observed(true),
            &["swap A and B", "encoder.directions = [1, -1, 1, 1]"],
        );
        has(
            &observed(false),
            &["wires of its motor", "motor.directions = [1, -1, 1, 1]"],
        );
        // A bit that is set already is to be cleared.
        let set = Reversed {
            encoders: 0b0110,
            ..NONE
        };
        let cleared = &judge(turned, [None; 4], &set)[1].problem;
        has(cleared, &["encoder.directions = [1, 1, -1, 1]"]);
        // Both: the counts look right, only the eye sees it.
        let both = Observed::Wheel {
            wheel: 0,
            forward: false,
        };
        has(
            &problems(good(), [Some(both), None, None, None])[0],
            &[
                "motor.directions = [-1, 1, 1, 1]",
                "encoder.directions = [-1, 1, 1, 1]",
            ],
        );
    }

    #[test]
    fn silence_and_crosstalk_are_named() {
        let mut turned = good();
        turned[3] = Turned::default();
        has(&problems(turned, [None; 4])[3], &["no encoder counts"]);
        let nothing = [None, None, None, Some(Observed::Nothing)];
        has(&problems(turned, nothing)[3], &["motor's plug"]);
        turned[3].ways = [0.0, 1.0, 0.0, 2.0];
        has(
            &problems(turned, [None; 4])[3],
            &["2 encoders", "front right, rear right"],
        );
    }

    #[test]
    fn an_encoder_with_other_counts_shows() {
        let mut turned = good();
        // Four times too few counts: a quarter of the rate at the same voltage.
        turned[2].speed = Some(3.2);
        has(
            &problems(turned, [None; 4])[2],
            &["0.25 times as fast", "2020:1"],
        );
    }
}
