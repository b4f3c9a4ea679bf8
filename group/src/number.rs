//! Numbers of a group file as its messages write them, and slips of units.

/// A number as TOML writes it.
pub fn shown(value: f64) -> String {
    if value.is_nan() {
        "nan".to_owned()
    } else {
        format!("{value}")
    }
}

/// At most four significant digits behind the point, without zeros at the end; a number that needs
/// more, or that is whole millions, with its power of ten.
pub(crate) fn rounded(value: f64) -> String {
    let is_long = value.abs() > 1e6 && value.abs() < 9e18 && value % 1e6 == 0.0;
    if value != 0.0 && value.abs() < 1e-3 || is_long {
        let text = format!("{value:.3e}");
        let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
        let digits = digits.trim_end_matches('0').trim_end_matches('.');
        return format!("{digits}e{power}");
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    text.to_owned()
}

/// What a number out of range was most likely meant to be: in thousandths of its unit, or an angle
/// in the other unit.
pub(crate) fn slip(value: f64, unit: &str, fits: impl Fn(f64) -> bool) -> Option<String> {
    let (candidate, as_what) = match unit {
        "m" => (value / 1e3, "millimetres"),
        "A" => (value / 1e3, "milliamperes"),
        "V" => (value / 1e3, "millivolts"),
        "ms" => (value * 1e3, "seconds"),
        "degrees" => (value.to_degrees(), "radians"),
        "rad/s" => (value.to_radians(), "degrees per second"),
        "m/s" => (value / 1e3, "mm/s"),
        _ => return None,
    };
    let usual = if unit.starts_with('V') || unit == "A" {
        value.abs() >= 1e3
    } else {
        true
    };
    (usual && fits(candidate))
        .then(|| format!("if the value is in {as_what}, write {}", rounded(candidate)))
}
