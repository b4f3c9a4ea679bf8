//! A robot without a floating-point unit under one load with robots that have one.
//!
//! `OMNIBUS_ELF` names the reference board's image and `OMNIBUS_ELF_KIT` that of the kit with an
//! STM32F103 (`cargo xtask test` builds both and says so).

mod common;

use omnibus::path::curve::Curve;
use sim::Backend;

/// Largest difference in displacement from a group of f32 robots: 0.05 % of the farthest point.
const SHARE: f64 = 5e-4;
/// By how much more the load may be strained than by f32 robots alone, mm.
const STRAIN_MM: f64 = 1.0;

mod kit {
    use super::*;

    /// The whole of the paper's figure-eight, as `cargo xtask demo --config mixed-fpu` drives it,
    /// against three reference boards.
    #[test]
    fn a_group_with_it_goes_where_f32_robots_go() {
        let mixed = common::group("mixed-fpu");
        let mut alike = mixed.clone();
        for robot in &mut alike.robots {
            robot.board = mixed.robots[0].board;
            robot.output = mixed.robots[0].output;
        }
        let images = || {
            ["OMNIBUS_ELF", "OMNIBUS_ELF_KIT"]
                .map(common::image)
                .to_vec()
        };
        let [alike, mixed] = [alike, mixed].map(|group| {
            let backend = Backend::Images(images());
            let drive = common::drive(&group, backend, Curve::FigureEight, false, true);
            assert_eq!(drive.result, Ok(()));
            drive
        });
        assert_eq!(alike.truth.len(), mixed.truth.len());
        let (mut apart, mut far) = (0.0_f64, 0.0_f64);
        let from = alike.truth[0].group;
        for (one, other) in alike.truth.iter().zip(&mixed.truth) {
            apart = apart.max((one.group.x - other.group.x).hypot(one.group.y - other.group.y));
            far = far.max((one.group.x - from.x).hypot(one.group.y - from.y));
        }
        let strain = [&alike, &mixed].map(|drive| drive.world.worst_shape_error_mm());
        println!(
            "{:.3} mm apart, {far:.2} m from the start; strain {:.3} and {:.3} mm",
            apart * 1e3,
            strain[0],
            strain[1]
        );
        assert!(apart > 0.0, "the kit's robot is another one");
        assert!(apart < SHARE * far, "{apart} m of {far} m");
        assert!(strain[1] < strain[0] + STRAIN_MM, "{strain:?} mm");
    }
}
