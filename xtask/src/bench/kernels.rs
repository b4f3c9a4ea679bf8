//! Instructions of the functions of the control tick, one by one: builds and runs `kernels/`.

use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context as _, bail, ensure};
use emulator::profile::Call;
use emulator::{Board, BoardConfig, Firmware};

use omnibus::report::Scalar;

use super::figure::Figure;
use crate::cargo;

/// A core with a floating-point unit, and one without, which runs the tick in either arithmetic.
const TARGETS: [(&str, Scalar, &str); 3] = [
    (cargo::TARGET, Scalar::F32, "m4f"),
    ("thumbv7m-none-eabi", Scalar::F32, "m3"),
    ("thumbv7m-none-eabi", Scalar::Fixed, "m3_fixed"),
];

/// Function, name of the figure, budget and ceiling on the M4F, best peer.
type Kernel = (
    &'static str,
    &'static str,
    Option<(f64, f64)>,
    Option<(f64, &'static str)>,
);

const KERNELS: [Kernel; 18] = [
    (
        "inverse",
        "inverse",
        Some((36.0, 36.0)),
        Some((40.0, "ROSbot")),
    ),
    (
        "inverse_desaturated",
        "inverse_desaturated",
        Some((85.0, 85.0)),
        Some((108.0, "ArduRover")),
    ),
    (
        "forward",
        "forward",
        Some((40.0, 40.0)),
        Some((696.0, "linorobot2")),
    ),
    (
        "forward_odometry",
        "forward_odometry",
        Some((160.0, 160.0)),
        Some((851.0, "ROSbot")),
    ),
    (
        "wheel_loop",
        "wheel_loop",
        Some((45.0, 45.0)),
        Some((639.0, "linorobot2")),
    ),
    ("compensation", "compensation", None, None),
    ("sine_cosine", "sincos", None, None),
    ("fixed_inverse", "inverse.fixed", Some((60.0, 60.0)), None),
    ("fixed_forward", "forward.fixed", None, None),
    ("secants_phase", "secants_phase", None, None),
    ("inverse_phase", "inverse_phase", Some((100.0, 100.0)), None),
    ("forward_phase", "forward_phase", Some((120.0, 120.0)), None),
    ("fixed_secants_phase", "secants_phase.fixed", None, None),
    (
        "fixed_inverse_phase",
        "inverse_phase.fixed",
        Some((100.0, 100.0)),
        None,
    ),
    (
        "fixed_forward_phase",
        "forward_phase.fixed",
        Some((120.0, 120.0)),
        None,
    ),
    ("tick", "tick_alone", None, None),
    ("tick_tables", "tick_tables", None, None),
    ("tick_phase", "tick_phase", None, None),
];

/// Largest mean of a whole tick in fixed point without a floating-point unit: budget and ceiling.
const FIXED_TICKS: [(&str, Option<f64>, f64); 3] = [
    ("tick_alone", Some(4_000.0), 4_000.0),
    ("tick_tables", None, 4_200.0),
    ("tick_phase", None, 5_200.0),
];

/// Time that the image is given, ns; on its 16 MHz it needs about half of it.
const TIME_NS: u64 = 2_000_000_000;

/// Builds the image for both cores, runs it, counts.
pub fn figures() -> anyhow::Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for (target, scalar, core) in TARGETS {
        let firmware = Firmware::load(build(target, scalar)?)?;
        let mut board = Board::new(&firmware, BoardConfig::default());
        board.start_profile();
        let address = |name: &str| {
            let end = format!("::{name}::");
            let found = firmware.functions().iter().find(|symbol| {
                symbol.name.contains("omnibus_kernels::")
                    && format!("{}::", symbol.name).contains(&end)
            });
            found
                .map(|symbol| symbol.address)
                .with_context(|| format!("the counting image has no function {name}"))
        };
        let nothing = address("nothing")?;
        let right = address("memory_is_right")?;
        let addresses = KERNELS
            .iter()
            .map(|(function, ..)| address(function))
            .collect::<anyhow::Result<Vec<_>>>()?;
        let soft: Vec<u32> = firmware
            .functions()
            .iter()
            .filter(|symbol| is_software_float(&symbol.name))
            .map(|symbol| symbol.address)
            .collect();
        ensure!(
            core == "m4f" || !soft.is_empty(),
            "{core}: the counting image has no software floating point under the names looked for"
        );
        if let Some(profile) = board.profile() {
            profile.watch(nothing);
            profile.watch(right);
            addresses.iter().for_each(|address| profile.watch(*address));
            soft.iter().for_each(|address| profile.watch(*address));
        }
        board.run_until(TIME_NS)?;
        let profile = board.take_profile().context("no call was counted")?;
        ensure!(
            profile.calls(right).len() == 1,
            "{core}: src/board/memory.rs copies, moves or fills wrongly, or did not finish"
        );
        let empty = profile
            .calls(nothing)
            .first()
            .map_or(0, |call| call.instructions);
        for ((function, name, bounds, peer), address) in KERNELS.iter().zip(addresses) {
            let counts = profile
                .calls(address)
                .iter()
                .map(|call| call.instructions - empty);
            ensure!(
                counts.len() == 64,
                "{function}: {} calls of 64",
                counts.len()
            );
            let mean = counts.clone().sum::<u64>() as f64 / 64.0;
            let figure = |what: &str, value: f64| {
                Figure::new(format!("{name}.{core}.{what}"), value, "instructions")
            };
            let mut worst = figure("max", counts.clone().max().unwrap_or_default() as f64);
            let mut middle = figure("mean", mean);
            if core == "m4f" {
                if let Some((budget, ceiling)) = bounds {
                    worst = worst.budget(*budget).ceiling(*ceiling);
                }
                if let Some((value, name)) = peer {
                    middle = middle.peer(*value, name);
                }
            }
            if core == "m3_fixed"
                && let Some((_, budget, ceiling)) =
                    FIXED_TICKS.iter().find(|(tick, ..)| tick == name)
            {
                middle = middle.ceiling(*ceiling);
                if let Some(budget) = budget {
                    middle = middle.budget(*budget);
                }
                let inside = profile.calls(address);
                let calls = soft.iter().flat_map(|address| profile.calls(*address));
                let calls = calls.filter(|call| {
                    let at = |tick: &&Call| {
                        tick.began < call.began
                            && call.began + call.cycles < tick.began + tick.cycles
                    };
                    inside.iter().find(at).is_some()
                });
                let name = format!("{name}.{core}.soft_float");
                figures.push(Figure::new(name, calls.count() as f64, "calls").ceiling(0.0));
            }
            figures.push(figure("min", counts.min().unwrap_or_default() as f64));
            figures.push(middle);
            figures.push(worst);
        }
    }
    Ok(figures)
}

/// Whether a function of this name computes with floats for a core that cannot.
fn is_software_float(name: &str) -> bool {
    let arm = [
        "__aeabi_f",
        "__aeabi_d",
        "__aeabi_i2",
        "__aeabi_ui2",
        "__aeabi_l2",
        "__aeabi_ul2",
    ];
    arm.iter().any(|begin| name.starts_with(begin)) || name.starts_with("compiler_builtins::float")
}

fn build(target: &str, scalar: Scalar) -> anyhow::Result<PathBuf> {
    let mut command = cargo::command();
    let status = command
        .args([
            "build",
            "--quiet",
            "--release",
            "--package",
            "omnibus-kernels",
        ])
        .args(["--target", target])
        .args(match scalar {
            Scalar::F32 => [].as_slice(),
            Scalar::Fixed => &["--features", "fixed-point"],
        })
        .stdout(Stdio::null())
        .status()
        .context("cannot start cargo")?;
    if !status.success() {
        bail!(
            "the counting image does not build for {target}; if that is not installed: rustup \
             target add {target}"
        );
    }
    let folder = cargo::target_folder().join(target);
    Ok(folder.join("release/omnibus-kernels"))
}
