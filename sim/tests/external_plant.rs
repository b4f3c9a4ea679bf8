//! The external plant against a plant of another make: `examples/plant.py`, and impostors.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};

use group::GroupFile;
use kinematics::Pose;
use omnibus_sim::plant::Plant;
use omnibus_sim::plant::external::ExternalPlant;

const START: Pose<f64> = Pose {
    x: 0.0,
    y: 0.0,
    heading: 0.0,
};

fn group(name: &str) -> GroupFile {
    GroupFile::load(format!(
        "{}/../groups/{name}.toml",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

/// The example, listening; `None` where there is no Python.
fn example() -> Option<(Child, String)> {
    let script = format!("{}/../examples/plant.py", env!("CARGO_MANIFEST_DIR"));
    let mut child = Command::new("python3")
        .args([&script, "0"])
        .stdout(Stdio::piped())
        .spawn()
        .ok()?;
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let port = line.trim().rsplit(' ').next().unwrap().to_owned();
    Some((child, format!("127.0.0.1:{port}")))
}

/// Three bolted robots strafe left at 0.2 m/s, then turn at 0.5 rad/s, by wheel rates in closed
/// form.
#[test]
fn the_python_example_moves_a_rigid_group() {
    let Some((mut child, address)) = example() else {
        // .ci/run asks for it, so that it cannot go missing there unnoticed.
        assert!(
            std::env::var_os("OMNIBUS_NEEDS_PYTHON").is_none(),
            "no python3 here; install it"
        );
        eprintln!("no python3 here: not tested");
        return;
    };
    let mut plant = ExternalPlant::connect(&group("tcc-3"), &address, START).unwrap();
    let dt = 1e-3;
    let strafe = 0.2 / 0.1524 * dt;
    for _ in 0..1_000 {
        plant
            .step(dt, &[[-strafe, strafe, strafe, -strafe]; 3])
            .unwrap();
    }
    // The radius the plant is told is the f32 nearest to 0.1524: relative error below 1e-7.
    let group = plant.group();
    assert!(
        (group.y - 0.2).abs() < 1e-7 && group.x.abs() < 1e-9,
        "{group:?}"
    );
    assert!((plant.wheel_angles(2).unwrap()[1] - 0.2 / 0.1524).abs() < 1e-9);
    let turn = 0.5 * (0.37 + 0.35) / 0.1524 * dt;
    for _ in 0..1_000 {
        plant.step(dt, &[[-turn, turn, -turn, turn]; 3]).unwrap();
    }
    assert!(
        (plant.group().heading - 0.5).abs() < 1e-7,
        "{:?}",
        plant.group()
    );
    assert!(plant.shape_error_mm() < 1e-6);
    child.kill().unwrap();
    child.wait().unwrap();
}

/// A plant that listens and answers one step with `answer`.
fn impostor(answer: &'static str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        let hello = lines.next().unwrap().unwrap();
        assert!(
            hello.starts_with("{\"omnibus_plant\":1,\"robots\":[{\"x\":0.0,"),
            "{hello}"
        );
        let step = lines.next().unwrap().unwrap();
        assert_eq!(
            step,
            "{\"t\":0.0,\"dt\":0.5,\"wheel_rate\":[[2.0,2.0,2.0,2.0]]}"
        );
        (&stream).write_all(answer.as_bytes()).unwrap();
    });
    address
}

fn error_of(answer: &'static str) -> String {
    let address = impostor(answer);
    let mut plant = ExternalPlant::connect(&group("single"), &address, START).unwrap();
    plant
        .step(0.5, &[[1.0; 4]])
        .unwrap_err()
        .to_string()
        .replace(&address, "HOST")
}

#[test]
fn a_plant_that_answers_nonsense_is_named() {
    let text = error_of("hello\n");
    assert!(
        text.starts_with("plant: HOST after 0 steps: answer not understood: "),
        "{text}"
    );
    assert_eq!(
        error_of("{\"wheel_angle\": [], \"pose\": [[0, 0, 0]]}\n"),
        "plant: HOST after 0 steps: 1 poses and 0 rows of wheel angles for 1 robots"
    );
}

#[test]
fn a_plant_that_goes_away_is_named() {
    assert_eq!(
        error_of(""),
        "plant: HOST after 0 steps: closed the connection"
    );
}

#[test]
fn nothing_listens() {
    let address = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .to_string();
    let text = ExternalPlant::connect(&group("single"), &address, START)
        .unwrap_err()
        .to_string();
    assert!(text.contains("no program answers there ("), "{text}");
    assert!(
        text.ends_with("; start the other simulator there first"),
        "{text}"
    );
}

#[test]
fn what_a_plant_complains_of_is_shown() {
    assert_eq!(
        error_of("{\"error\": \"robot 0 fell over\"}\n"),
        "plant: HOST after 0 steps: it says: robot 0 fell over"
    );
}

#[test]
fn inertia_without_torques_is_refused() {
    let zero = "[[0.0, 0.0, 0.0, 0.0]]";
    for forces in [
        "\"wheel_inertia\": 0.1",
        "\"floor_torque\": [[0.0, 0.0, 0.0, 0.0]]",
        "\"wheel_inertia\": -0.1, \"floor_torque\": [[0.0, 0.0, 0.0, 0.0]]",
        "\"wheel_inertia\": 0.1, \"floor_torque\": []",
    ] {
        let answer = format!("{{\"wheel_angle\": {zero}, \"pose\": [[0, 0, 0]], {forces}}}\n");
        let text = error_of(answer.leak());
        assert!(
            text.contains("wheel_inertia") || text.contains("floor_torque"),
            "{text}"
        );
    }
}

/// A plant that pushes all wheels of one robot with a torque; the wheels' rate after 50 ms.
fn pushed(torque: f64) -> f64 {
    /// kg m2, ten times what the robot's own motors are given.
    const INERTIA: f64 = 4.0;
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let plant = std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        lines.next().unwrap().unwrap();
        let (mut angle, mut rate, mut torques) = (0.0, 0.0, 0);
        while let Some(Ok(line)) = lines.next() {
            let step: serde_json::Value = serde_json::from_str(&line).unwrap();
            rate = step["wheel_rate"][0][0].as_f64().unwrap();
            angle += rate * step["dt"].as_f64().unwrap();
            // From the second step on: then this plant is known to have forces.
            torques += u32::from(step["wheel_torque"][0][3].is_f64());
            let answer = format!(
                "{{\"wheel_angle\": [[{angle}, {angle}, {angle}, {angle}]], \"pose\": [[0, 0, 0]],\
                 \"wheel_inertia\": {INERTIA},\
                 \"floor_torque\": [[{torque}, {torque}, {torque}, {torque}]]}}\n"
            );
            (&stream).write_all(answer.as_bytes()).unwrap();
        }
        (rate, torques)
    });
    let mut file = group("single");
    file.simulation.plant = group::Plant::External { address };
    let options = omnibus_sim::Options {
        truth_period_ns: 0,
        ..omnibus_sim::Options::default()
    };
    let mut world = omnibus_sim::World::new(&file, omnibus_sim::Backend::Native, options).unwrap();
    world.run_until(canopen::Micros(50_000)).unwrap();
    drop(world);
    let (rate, torques) = plant.join().unwrap();
    assert_eq!(torques, 49, "steps of 1 ms after the first");
    rate
}

/// Wheels whose brake slips turn by (torque - friction) t / inertia: of two torques the
/// difference does not know the friction. The torque acts from 1 ms on, and the last rate told is
/// the mean over the last step; 3 % are a step and a half.
#[test]
fn the_floor_turns_wheels_against_their_inertia() {
    let (a, b) = (pushed(120.0), pushed(160.0));
    let wanted = 40.0 / 4.0 * 0.0485;
    assert!((b - a - wanted).abs() < 0.03 * wanted, "{a} {b}, {wanted}");
}
