//! NURBS against closed forms, and the legs that edges become.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use kinematics::Pose;
use omnibus_vda5050::leg::{legs, wrapped};
use omnibus_vda5050::message::order::{Edge, NodePosition, Trajectory};
use omnibus_vda5050::nurbs::Nurbs;
use serde_json::{Value, json};

fn curve(value: Value) -> Result<Nurbs, String> {
    Nurbs::new(&serde_json::from_value::<Trajectory>(value).unwrap())
}

/// A quarter of the unit circle: degree 2, middle weight 1/sqrt 2 (Piegl and Tiller, 7.3).
fn quarter() -> Value {
    json!({"degree": 2, "knotVector": [0, 0, 0, 1, 1, 1], "controlPoints":
        [{"x": 1, "y": 0}, {"x": 1, "y": 1, "weight": FRAC_1_SQRT_2}, {"x": 0, "y": 1}]})
}

#[test]
fn a_rational_quadratic_is_a_circle() {
    let curve = curve(quarter()).unwrap();
    for step in 0..=100 {
        let ([x, y], [dx, dy]) = curve.at(f64::from(step) / 100.0);
        assert!((x.hypot(y) - 1.0).abs() < 1e-14, "on the circle");
        assert!((x * dx + y * dy).abs() < 1e-13, "along the tangent");
    }
    let ([x, y], _) = curve.at(0.5);
    assert!((x - FRAC_1_SQRT_2).abs() < 1e-14 && (y - x).abs() < 1e-14);
}

/// The whole circle by nine points, with double inner knots.
#[test]
fn nine_points_are_a_whole_circle() {
    let w = FRAC_1_SQRT_2;
    let points: Vec<Value> = [
        (1, 0),
        (1, 1),
        (0, 1),
        (-1, 1),
        (-1, 0),
        (-1, -1),
        (0, -1),
        (1, -1),
        (1, 0),
    ]
    .into_iter()
    .enumerate()
    .map(|(n, (x, y))| json!({"x": x, "y": y, "weight": if n % 2 == 1 { w } else { 1.0 }}))
    .collect();
    let knots = [
        0.0, 0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0, 1.0, 1.0,
    ];
    let circle = curve(json!({"degree": 2, "knotVector": knots, "controlPoints": points})).unwrap();
    for step in 0..=400 {
        let ([x, y], _) = circle.at(f64::from(step) / 400.0);
        assert!((x.hypot(y) - 1.0).abs() < 1e-14);
    }
}

/// A cubic Bezier curve has its Bernstein form.
#[test]
fn clamped_knots_without_inner_ones_are_a_bezier_curve() {
    let p = [(0.0, 0.0), (1.0, 2.0), (3.0, -1.0), (4.0, 1.0)];
    let points: Vec<Value> = p.iter().map(|(x, y)| json!({"x": x, "y": y})).collect();
    let given = curve(
        json!({"degree": 3, "knotVector": [0, 0, 0, 0, 1, 1, 1, 1], "controlPoints": points}),
    );
    // 3.0: knots may be left out.
    let left_out = curve(json!({"degree": 3, "controlPoints": points})).unwrap();
    let given = given.unwrap();
    assert_eq!(given, left_out);
    for step in 0..=50 {
        let u = f64::from(step) / 50.0;
        let v = 1.0 - u;
        let bernstein = [v * v * v, 3.0 * v * v * u, 3.0 * v * u * u, u * u * u];
        let slopes = [
            -3.0 * v * v,
            3.0 * v * v - 6.0 * v * u,
            6.0 * v * u - 3.0 * u * u,
            3.0 * u * u,
        ];
        let sum = |c: [f64; 4], of: fn(&(f64, f64)) -> f64| -> f64 {
            c.iter().zip(&p).map(|(c, p)| c * of(p)).sum()
        };
        let ([x, y], [dx, dy]) = given.at(u);
        assert!(
            (x - sum(bernstein, |p| p.0)).abs() < 1e-13
                && (y - sum(bernstein, |p| p.1)).abs() < 1e-13
        );
        assert!(
            (dx - sum(slopes, |p| p.0)).abs() < 1e-12 && (dy - sum(slopes, |p| p.1)).abs() < 1e-12
        );
    }
}

#[test]
fn degree_one_is_a_polyline_and_unclamped_knots_have_their_domain() {
    let line =
        curve(json!({"controlPoints": [{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 1, "y": 2}]}))
            .unwrap();
    assert_eq!(line.at(0.25).0, [0.5, 0.0]);
    assert_eq!(line.at(0.75).0, [1.0, 1.0]);
    let knots = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
    let points = [(0, 0), (1, 0), (2, 0)].map(|(x, y)| json!({"x": x, "y": y}));
    let open = curve(json!({"degree": 2, "knotVector": knots, "controlPoints": points})).unwrap();
    // A uniform quadratic B-spline begins half way between its first two points.
    let (low, high) = open.domain();
    assert!((open.at(low).0[0] - 0.5).abs() < 1e-14 && (open.at(high).0[0] - 1.5).abs() < 1e-14);
}

#[test]
fn wrong_curves_are_refused_by_field() {
    let points = [(0, 0), (1, 0), (2, 0)].map(|(x, y)| json!({"x": x, "y": y}));
    let with = |degree: f64, knots: Value| json!({"degree": degree, "knotVector": knots, "controlPoints": points});
    for (value, word) in [
        (with(0.0, json!([])), "degree: 0"),
        (with(1.5, json!([])), "degree: 1.5"),
        (with(1e9, json!([])), "degree: 1000000000"),
        (with(3.0, json!([])), "controlPoints: 3 points"),
        (with(2.0, json!([0, 0, 0, 1, 1])), "5 knots"),
        (with(2.0, json!([0, 0, 0, 1, 0.5, 1])), "0.5 comes after 1"),
        (with(2.0, json!([0, 0, 0, 2, 2, 2])), "between 0 and 1"),
        (with(2.0, json!([0, 0, 0, 0, 1, 1])), "no length"),
        (
            json!({"degree": 1, "knotVector": [0, 0, 0.5, 0.5, 1, 1],
            "controlPoints": [{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 5, "y": 0}, {"x": 6, "y": 0}]}),
            "tears",
        ),
        (
            json!({"controlPoints": [{"x": 0, "y": 0, "weight": 0}, {"x": 1, "y": 0}]}),
            "weight: 0",
        ),
        (
            json!({"controlPoints": [{"x": 0, "y": 0}, {"x": 1e9, "y": 0}]}),
            "1000 km",
        ),
    ] {
        let why = curve(value.clone()).unwrap_err();
        assert!(why.contains(word), "{value}: {why}");
    }
}

fn node(value: Value) -> NodePosition {
    serde_json::from_value(value).unwrap()
}

fn edge(extra: Value) -> Edge {
    let mut edge = json!({"edgeId": "e", "sequenceId": 1, "released": true, "startNodeId": "a",
        "endNodeId": "b", "actions": []});
    edge.as_object_mut()
        .unwrap()
        .extend(extra.as_object().unwrap().clone());
    serde_json::from_value(edge).unwrap()
}

/// Headings at the beginning, the middle and the end of each leg.
fn headings(extra: Value, from: Value, to: Value, start: f64) -> Vec<[f64; 3]> {
    let (from, to) = (node(from), node(to));
    let start = Pose::new(from.x, from.y, start);
    let legs = legs(&edge(extra), &from, &to, start, 2, 0.1).unwrap();
    assert_eq!(legs.last().unwrap().arrives, Some(2));
    assert!(legs.iter().rev().skip(1).all(|leg| leg.arrives.is_none()));
    let at = |leg: &omnibus_vda5050::leg::Leg, n: usize| {
        leg.poses[n * (leg.poses.len() - 1) / 2].heading
    };
    legs.iter()
        .map(|leg| [0, 1, 2].map(|n| at(leg, n)))
        .collect()
}

#[test]
fn headings_on_an_edge_follow_chapter_6_7() {
    let a = || json!({"x": 0, "y": 0, "mapId": "m"});
    let b = || json!({"x": 0, "y": 2, "mapId": "m"});
    let b_at = |theta: f64| json!({"x": 0, "y": 2, "theta": theta, "mapId": "m"});
    let near = |found: Vec<[f64; 3]>, wanted: &[[f64; 3]]| {
        assert_eq!(found.len(), wanted.len(), "{found:?}");
        for (found, wanted) in found.iter().flatten().zip(wanted.iter().flatten()) {
            assert!((found - wanted).abs() < 1e-9, "{found} for {wanted}");
        }
    };
    // Nothing said: the heading stays; with a heading at the end it is reached on the way.
    near(headings(json!({}), a(), b(), 0.3), &[[0.3, 0.3, 0.3]]);
    near(headings(json!({}), a(), b_at(1.3), 0.3), &[[0.3, 0.8, 1.3]]);
    // Tangential is the default: forwards along +y, or sideways.
    near(
        headings(json!({"orientation": 0.0}), a(), b(), FRAC_PI_2),
        &[[FRAC_PI_2; 3]],
    );
    near(
        headings(json!({"orientation": 0.0}), a(), b(), 0.0),
        &[[0.0, FRAC_PI_2, FRAC_PI_2]],
    );
    let sideways = json!({"orientation": -FRAC_PI_2, "orientationType": "TANGENTIAL"});
    near(headings(sideways, a(), b(), 0.0), &[[0.0; 3]]);
    let global = json!({"orientation": 1.0, "orientationType": "GLOBAL"});
    near(headings(global, a(), b(), 1.0), &[[1.0; 3]]);
    // No turning on the edge: before it and, for the node, after it.
    let first = json!({"orientation": 1.0, "orientationType": "GLOBAL", "rotationAllowed": false});
    near(
        headings(first, a(), b_at(0.0), 0.0),
        &[[0.0, 0.5, 1.0], [1.0; 3], [1.0, 0.5, 0.0]],
    );
    let first = json!({"orientation": 1.0, "orientationType": "GLOBAL", "reachOrientationBeforeEntering": true});
    near(headings(first, a(), b(), 0.0), &[[0.0, 0.5, 1.0], [1.0; 3]]);
    near(
        headings(json!({"rotationAllowed": false}), a(), b_at(1.0), 0.0),
        &[[0.0; 3], [0.0, 0.5, 1.0]],
    );
    // A turn goes the short way, and a deviation that is allowed needs none.
    near(
        headings(json!({}), a(), b_at(-3.0), 3.0),
        &[[3.0, PI, 2.0 * PI - 3.0]],
    );
    // VDA5050#370: a turn on the spot is an edge between two nodes of one place.
    let turn = headings(
        json!({}),
        a(),
        json!({"x": 0, "y": 0, "theta": 1.0, "mapId": "m"}),
        0.0,
    );
    near(turn, &[[0.0, 0.5, 1.0]]);
}

#[test]
fn a_circle_is_followed_with_the_front_ahead() {
    let (from, to) = (
        node(json!({"x": 1, "y": 0, "mapId": "m"})),
        node(json!({"x": 0, "y": 1, "mapId": "m"})),
    );
    let way = edge(json!({"orientation": 0.0, "maxSpeed": 0.5, "trajectory": quarter()}));
    let found = legs(&way, &from, &to, Pose::new(1.0, 0.0, FRAC_PI_2), 2, 0.1).unwrap();
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].max_speed, Some(0.5));
    for pose in &found[0].poses[1..found[0].poses.len() - 1] {
        assert!((pose.x.hypot(pose.y) - 1.0).abs() < 1e-12);
        assert!(wrapped(pose.heading - pose.y.atan2(pose.x) - FRAC_PI_2).abs() < 1e-4);
    }
    // A vehicle beside the beginning goes there first.
    let found = legs(&way, &from, &to, Pose::new(1.05, 0.0, FRAC_PI_2), 2, 0.1).unwrap();
    assert_eq!(found.len(), 2);
    assert_eq!(found[0].end().unwrap().x, 1.0);
}
