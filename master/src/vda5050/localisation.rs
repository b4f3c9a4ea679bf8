//! Where the group is on the map.
//!
//! A source of poses has a frame of its own. The map is reached by one offset: the pose of that
//! frame on the map. For poses from outside it is given, or the frames are one. Wheels know no
//! place, only distances: for them the offset follows from where the group stands when that is
//! told, at the start or by `initPosition`.

use kinematics::Pose;

/// The inverse of a pose.
fn inverse(pose: Pose<f64>) -> Pose<f64> {
    let (sin, cos) = pose.heading.sin_cos();
    let (x, y) = (-cos * pose.x - sin * pose.y, sin * pose.x - cos * pose.y);
    Pose::new(x, y, -pose.heading)
}

/// `inner`, given in the frame at `frame`.
fn compose(frame: Pose<f64>, inner: Pose<f64>) -> Pose<f64> {
    let (sin, cos) = frame.heading.sin_cos();
    Pose::new(
        frame.x + cos * inner.x - sin * inner.y,
        frame.y + sin * inner.x + cos * inner.y,
        frame.heading + inner.heading,
    )
}

/// The offset, and what is known without it.
#[derive(Clone, Debug, Default)]
pub struct Localisation {
    offset: Option<Pose<f64>>,
    /// Where the group stands on the map, as long as its source has not said anything.
    anchor: Option<Pose<f64>>,
    seen: Option<Pose<f64>>,
}

impl Localisation {
    /// The frame of the source lies here on the map.
    pub fn with_offset(offset: Pose<f64>) -> Self {
        Self {
            offset: Some(offset),
            ..Self::default()
        }
    }

    /// The group stands here on the map, whatever its source says.
    pub fn set(&mut self, pose: Pose<f64>) {
        self.anchor = Some(pose);
        self.offset = self.seen.map(|seen| compose(pose, inverse(seen)));
    }

    /// The source has said where the group is.
    pub fn see(&mut self, seen: Pose<f64>) {
        self.seen = Some(seen);
        if let (None, Some(anchor)) = (self.offset, self.anchor) {
            self.offset = Some(compose(anchor, inverse(seen)));
        }
    }

    /// Where the group is on the map.
    pub fn pose(&self) -> Option<Pose<f64>> {
        match (self.offset, self.seen) {
            (Some(offset), Some(seen)) => Some(compose(offset, seen)),
            _ => self.anchor,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn is_near(a: Option<Pose<f64>>, b: Pose<f64>) {
        let a = a.unwrap();
        let off = (a.x - b.x).hypot(a.y - b.y).hypot(a.heading - b.heading);
        assert!(off < 1e-12, "{a:?} is not {b:?}");
    }

    #[test]
    fn an_offset_turns_and_moves_what_is_seen() {
        let mut place = Localisation::with_offset(Pose::new(10.0, 5.0, FRAC_PI_2));
        assert_eq!(place.pose(), None);
        place.see(Pose::new(2.0, 1.0, 0.25));
        is_near(place.pose(), Pose::new(9.0, 7.0, FRAC_PI_2 + 0.25));
    }

    #[test]
    fn a_place_that_was_told_holds_from_what_is_seen_next() {
        let mut place = Localisation::default();
        assert_eq!(place.pose(), None, "wheels alone know no place");
        place.set(Pose::new(3.0, 4.0, FRAC_PI_2));
        is_near(place.pose(), Pose::new(3.0, 4.0, FRAC_PI_2));
        place.see(Pose::new(1.0, 1.0, 0.0));
        is_near(place.pose(), Pose::new(3.0, 4.0, FRAC_PI_2));
        place.see(Pose::new(2.0, 1.0, 0.5));
        is_near(place.pose(), Pose::new(3.0, 5.0, FRAC_PI_2 + 0.5));
        place.set(Pose::new(0.0, 0.0, 0.0));
        is_near(place.pose(), Pose::new(0.0, 0.0, 0.0));
        place.see(Pose::new(2.0, 2.0, 0.5));
        let (sin, cos) = (-0.5_f64).sin_cos();
        is_near(place.pose(), Pose::new(-sin, cos, 0.0));
    }
}
