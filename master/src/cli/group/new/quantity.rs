//! Numbers with units, as people type them.

/// A unit and how many of the file's it is.
pub(super) type Units = &'static [(&'static str, f64)];

/// The weight of a kilogram, N.
pub(super) const KILOGRAM_FORCE: f64 = 9.806_65;

/// The weight of an ounce, a sixteenth of a pound, N.
pub(super) const OUNCE_FORCE: f64 = 4.448_221_615 / 16.0;

/// An inch, m.
pub(super) const INCH: f64 = 0.0254;

pub(super) const LENGTH: Units = &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("in", INCH)];

pub(super) const MASS: Units = &[("kg", 1.0), ("g", 1e-3)];

pub(super) const VOLTAGE: Units = &[("v", 1.0)];

pub(super) const CURRENT: Units = &[("a", 1.0), ("ma", 1e-3)];

pub(super) const SPEED: Units = &[("rpm", std::f64::consts::TAU / 60.0), ("rad/s", 1.0)];

pub(super) const TORQUE: Units = &[
    ("nm", 1.0),
    ("ncm", 1e-2),
    ("kgcm", KILOGRAM_FORCE * 1e-2),
    ("kgfcm", KILOGRAM_FORCE * 1e-2),
    ("ozin", OUNCE_FORCE * INCH),
];

pub(super) const PLAIN: Units = &[("", 1.0)];

/// Longest track and wheelbase of a group file, m.
const LONGEST: f64 = 10.0;

/// Farthest that a robot may be from the origin along an axis, m: objects 0x2011:1 and 2.
const FARTHEST: f64 = 50.0;

/// A number with one of the units; the first one where it has none. It must be above 0, or 0 where
/// `zero` allows it.
pub(super) fn quantity(text: &str, units: Units, zero: bool) -> Result<f64, String> {
    let text = text.trim();
    let end = text
        .rfind(|c: char| c.is_ascii_digit() || c == '.' && text.ends_with('.'))
        .map_or(0, |n| n + 1);
    let (digits, unit) = text.split_at(end);
    let unit: String = unit
        .chars()
        .filter(|c| !matches!(c, ' ' | '.' | '*' | '·' | '-'))
        .flat_map(char::to_lowercase)
        .collect();
    let names: Vec<_> = units.iter().map(|(name, _)| *name).collect();
    let known = units.iter().find(|(name, _)| *name == unit);
    let factor = match (known, unit.is_empty()) {
        (Some((_, factor)), _) => *factor,
        (None, true) => units[0].1,
        (None, false) => {
            return Err(format!(
                "\"{unit}\" is not one of its units: {}",
                names.join(", ")
            ));
        }
    };
    let value: f64 = digits
        .trim()
        .parse()
        .map_err(|_| format!("\"{text}\" is not a number"))?;
    if !value.is_finite() || value < 0.0 || value == 0.0 && !zero {
        return Err(format!("\"{text}\" is not above 0"));
    }
    let value = value * factor;
    if units == LENGTH && value > LONGEST {
        return Err(format!(
            "\"{text}\" is {value} m; give at most {LONGEST} m, or another unit: 300mm"
        ));
    }
    Ok(value)
}

/// Where a robot is: x, y in m, heading in degrees.
pub(super) fn place(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let [x, y, heading] = match numbers.as_deref() {
        Ok(&[x, y]) => [x, y, 0.0],
        Ok(&[x, y, heading]) => [x, y, heading],
        _ => return Err(format!("\"{text}\" is not X,Y or X,Y,DEGREES in metres")),
    };
    // What is no number is not within.
    if !(x.abs() <= FARTHEST && y.abs() <= FARTHEST && heading.abs() <= 360.0) {
        return Err(format!(
            "\"{text}\": give X and Y of -{FARTHEST} to {FARTHEST} m and at most 360 degrees"
        ));
    }
    Ok([x, y, heading])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_take_units() {
        let of = |text, units| quantity(text, units, false);
        assert_eq!(of("300mm", LENGTH), Ok(0.3));
        assert_eq!(of("0.3", LENGTH), Ok(0.3));
        assert_eq!(of("30 cm", LENGTH), Ok(0.3));
        assert_eq!(of("10in", LENGTH), Ok(0.254));
        assert_eq!(of("200 mA", CURRENT), Ok(0.2));
        // 1 kg cm is 9.80665 N x 0.01 m, 1 oz in is 4.448/16 N x 0.0254 m.
        assert!((of("14 kg.cm", TORQUE).unwrap() - 1.372_931).abs() < 1e-6);
        assert!((of("100oz-in", TORQUE).unwrap() - 0.706_155).abs() < 1e-6);
        // 60 rpm is one turn a second.
        assert!((of("60rpm", SPEED).unwrap() - std::f64::consts::TAU).abs() < 1e-12);
        assert!(
            of("3 parsec", LENGTH)
                .unwrap_err()
                .contains("m, cm, mm, in")
        );
        assert!(of("-3", LENGTH).is_err() && of("0", LENGTH).is_err() && of("", LENGTH).is_err());
        assert_eq!(quantity("0", CURRENT, true), Ok(0.0));
        assert!(of("300", LENGTH).unwrap_err().contains("300mm"));
    }

    #[test]
    fn places_are_near_and_finite() {
        assert_eq!(place("0.25, -0.3"), Ok([0.25, -0.3, 0.0]));
        assert_eq!(place("0,50,-90"), Ok([0.0, 50.0, -90.0]));
        for text in ["nan,0", "0,inf", "0,0,nan", "0,50.1", "250,0", "0,0,361"] {
            assert!(place(text).is_err(), "{text}");
        }
    }
}
