//! The table plant gives the paper's tables back: wheels turn as they were set, and the distance
//! the robot covers is what the paper measured, to the digits it prints.

#![expect(
    clippy::approx_constant,
    reason = "the paper prints 15, 30 and 45 degrees like this"
)]

use group::GroupFile;
use kinematics::{
    FourWheelGeometry, MemberKinematics, Mount, Pose, Twist, VelocityCompensation, WheelRates,
};
use omnibus_sim::plant::Plant;
use omnibus_sim::plant::table::TablePlant;

const ORIGIN: Pose<f64> = Pose {
    x: 0.0,
    y: 0.0,
    heading: 0.0,
};
/// Ten seconds in plant steps of 1 ms.
const STEPS: u32 = 10_000;
const DT: f64 = 1e-3;

fn group(name: &str, tables: &str) -> GroupFile {
    let path = format!("{}/../groups/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replace("tables = \"virtual\"", &format!("tables = \"{tables}\""));
    GroupFile::parse(name, &text).unwrap()
}

/// Mean velocity of a single robot whose wheels were set for `asked`.
fn measured(tables: &str, asked: Twist<f64>) -> Twist<f64> {
    let group = group("single", tables);
    let group::Plant::Table(kind) = group.simulation.plant else {
        panic!("a table plant")
    };
    let mut plant = TablePlant::new(&group, kind, ORIGIN).unwrap();
    let robot = &group.robots[0].geometry;
    let wheels = FourWheelGeometry::new(
        f64::from(robot.half_track()),
        f64::from(robot.half_wheelbase()),
        f64::from(robot.wheel_radius()),
        f64::from(robot.roller_angle()),
    )
    .unwrap();
    let none = VelocityCompensation::new(1.0, 1.0, 1.0).unwrap();
    let kinematics = MemberKinematics::new(&wheels, &Mount::new(ORIGIN).unwrap(), &none).unwrap();
    let rates: WheelRates<f64> = kinematics.inverse(asked);
    let turned = <[f64; 4]>::from(rates).map(|rate| rate * DT);
    for _ in 0..STEPS {
        plant.step(DT, &[turned]).unwrap();
    }
    let seconds = f64::from(STEPS) * DT;
    let end = plant.poses()[0];
    Twist::new(end.x / seconds, end.y / seconds, end.heading / seconds)
}

/// Rounds as the paper prints: mm/s to three decimals, rad/s to three.
fn printed(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn straight(tables: &str, rows: &[(f64, f64)]) {
    for (set, expected) in rows {
        for sign in [1.0, -1.0] {
            let twist = measured(tables, Twist::new(sign * set / 1e3, 0.0, 0.0));
            assert_eq!(printed(twist.vx * 1e3), sign * expected, "{set} mm/s");
            assert!(twist.vy.abs() < 1e-12 && twist.omega.abs() < 1e-12);
        }
    }
}

fn sideways(tables: &str, rows: &[(f64, f64)]) {
    for (set, expected) in rows {
        for sign in [1.0, -1.0] {
            let twist = measured(tables, Twist::new(0.0, sign * set / 1e3, 0.0));
            assert_eq!(printed(twist.vy * 1e3), sign * expected, "{set} mm/s");
        }
    }
}

fn turning(tables: &str, rows: &[(f64, f64)]) {
    for (set, expected) in rows {
        for sign in [1.0, -1.0] {
            let twist = measured(tables, Twist::new(0.0, 0.0, sign * set));
            assert_eq!(printed(twist.omega), sign * expected, "{set} rad/s");
        }
    }
}

#[test]
fn table_3_longitudinal() {
    let rows = [
        (100.0, 99.767),
        (200.0, 199.564),
        (300.0, 299.339),
        (400.0, 399.151),
        (500.0, 498.905),
    ];
    straight("virtual", &rows);
}

/// 500 mm/s is the text's value; the table's row is lost.
#[test]
fn table_3_lateral() {
    sideways(
        "virtual",
        &[
            (100.0, 96.928),
            (200.0, 193.684),
            (300.0, 290.504),
            (500.0, 483.2),
        ],
    );
}

#[test]
fn table_5_turning() {
    turning(
        "virtual",
        &[(0.261799, 0.257), (0.523599, 0.514), (0.785398, 0.768)],
    );
}

#[test]
fn table_7_longitudinal() {
    let rows = [
        (100.0, 97.822),
        (200.0, 196.287),
        (300.0, 293.731),
        (400.0, 390.558),
        (500.0, 486.907),
    ];
    straight("physical", &rows);
}

#[test]
fn table_7_lateral() {
    let rows = [
        (100.0, 87.621),
        (200.0, 174.193),
        (300.0, 260.675),
        (400.0, 345.426),
        (500.0, 432.065),
    ];
    sideways("physical", &rows);
}

#[test]
fn table_8_turning() {
    turning("physical", &[(0.523599, 0.511), (1.047198, 1.020)]);
}

/// Three connected robots strafe as one body and lose what one loses.
#[test]
fn a_rigid_group_loses_what_its_members_lose() {
    let group = group("tcc-3", "virtual");
    let mut plant = TablePlant::new(&group, group::Tables::Virtual, ORIGIN).unwrap();
    let rate = 0.2 / f64::from(group.robots[0].geometry.wheel_radius());
    // Left: front left and rear right backwards.
    let turned = [-rate, rate, rate, -rate].map(|rate| rate * DT);
    for _ in 0..STEPS {
        plant.step(DT, &[turned; 3]).unwrap();
    }
    assert_eq!(printed(plant.group().y * 100.0), 193.684);
    assert!(plant.shape_error_mm() < 1e-9);
    let poses = plant.poses();
    assert!((poses[0].x - poses[2].x - 2.4).abs() < 1e-6, "{poses:?}");
}

/// One of three members stands still: the body goes two thirds of the way and the strain shows.
#[test]
fn a_member_that_stands_strains_the_load() {
    let group = group("tcc-3", "ideal");
    let mut plant = TablePlant::new(&group, group::Tables::Ideal, ORIGIN).unwrap();
    let ahead = [1e-3 / f64::from(group.robots[0].geometry.wheel_radius()); 4];
    for _ in 0..30 {
        plant.step(DT, &[ahead, [0.0; 4], ahead]).unwrap();
    }
    assert!((plant.group().x - 0.02).abs() < 1e-12);
    assert!((plant.shape_error_mm() - 20.0).abs() < 1e-9);
}

/// Free robots go where their own wheels take them.
#[test]
fn free_robots_drift_apart() {
    let mut group = group("tcc-2", "ideal");
    group.simulation.rigid = false;
    let mut plant = TablePlant::new(&group, group::Tables::Ideal, ORIGIN).unwrap();
    let ahead = [1e-3 / f64::from(group.robots[0].geometry.wheel_radius()); 4];
    for _ in 0..30 {
        plant.step(DT, &[ahead, [0.0; 4]]).unwrap();
    }
    let poses = plant.poses();
    assert!(
        (poses[0].x - 0.63).abs() < 1e-6 && (poses[1].x + 0.6).abs() < 1e-6,
        "{poses:?}"
    );
    assert!((plant.shape_error_mm() - 15.0).abs() < 1e-9);
}
