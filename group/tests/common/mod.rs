//! What the tests of group files share: a valid robot and two members of it, as literals for
//! `concat!`, because some tests count the lines of the whole.

macro_rules! robot {
    () => {
        r#"[robot]
half_track = 0.37
half_wheelbase = 0.35
wheel_radius = 0.1524
roller_angle_deg = 45
max_wheel_rate = 22
encoder = { counts_per_revolution = 40000 }
motor = { supply = 24, constant = 0.8, resistance = 0.3, inertia = 0.4 }
"#
    };
}

macro_rules! members {
    () => {
        r#"
[[robots]]
node = 2
x = 0.6

[[robots]]
node = 3
x = -0.6
"#
    };
}
