//! One robot on the bench: an image on an emulated board with its motors, its bus and its log. Time
//! passes here, driven by the clock or by a debugger, so that endpoints are served, the log is
//! printed and the trace is written whatever else goes on.

use std::fs::File;
use std::io::BufWriter;

use crate::output::print_line;
use crate::serve::HELD;
use anyhow::Context as _;
use canopen::Micros;
use emulator::waveform::{Signals, Waveform};
use emulator::{Board, Port};
use omnibus_sim::World;
use omnibus_sim::endpoint::Endpoint;

/// Virtual time between two looks at the endpoints, ns.
const ENDPOINTS_NS: u64 = 500_000;

/// The wheels in the order of the PWM channels and of the encoder timers TIM2 to TIM5.
const WHEELS: [&str; 4] = ["front_left", "front_right", "rear_left", "rear_right"];

/// The world of one emulated robot.
pub struct Bench {
    pub world: World,
    pub node: u8,
    endpoints: Vec<Box<dyn Endpoint>>,
    waveform: Option<Waveform<BufWriter<File>>>,
    served_ns: u64,
}

impl Bench {
    pub fn new(world: World, node: u8, endpoints: Vec<Box<dyn Endpoint>>) -> Self {
        Self {
            world,
            node,
            endpoints,
            waveform: None,
            served_ns: 0,
        }
    }

    /// Writes a trace from now on.
    pub fn trace(&mut self, file: File) -> anyhow::Result<()> {
        let name = format!("node_{}", self.node);
        self.waveform = Some(Waveform::new(BufWriter::new(file), &name, &signals())?);
        self.board()?.start_trace_of_program();
        Ok(())
    }

    /// The robot's board.
    pub fn board(&mut self) -> anyhow::Result<&mut Board> {
        let node = self.node;
        self.world
            .board(node)
            .with_context(|| format!("node {node} is not an emulated robot"))
    }

    /// Lets time pass, as far as no endpoint holds it. One that does is waited for a moment.
    pub fn advance(&mut self, ns: u64) -> anyhow::Result<()> {
        if self.world.now_ns() >= self.served_ns {
            self.served_ns = self.world.now_ns() + ENDPOINTS_NS;
            for endpoint in &mut self.endpoints {
                endpoint
                    .exchange(&mut self.world)
                    .with_context(|| format!("{} is lost", endpoint.announce()))?;
            }
        }
        let now = self.world.now();
        let mut until = Micros(self.world.now_ns().saturating_add(ns).div_ceil(1_000));
        for endpoint in &self.endpoints {
            let Some(limit) = endpoint.limit(now) else {
                continue;
            };
            if limit <= now {
                let listeners = self.endpoints.iter().filter_map(|one| one.listener());
                endpoint.wait(&listeners.collect::<Vec<_>>(), HELD);
                self.served_ns = 0;
                return Ok(());
            }
            until = until.min(limit);
            self.served_ns = self.served_ns.min(limit.0.saturating_mul(1_000));
        }
        let result = self.world.run_until(until);
        for (_, line) in self.world.take_logs() {
            let seconds = line.time_us as f64 * 1e-6;
            print_line(format_args!(
                "{seconds:12.6} {:5} {}",
                line.level, line.text
            ))?;
        }
        if let Some(mut waveform) = self.waveform.take() {
            let changes = self.board()?.take_trace();
            waveform.write(changes).context("the trace is incomplete")?;
            self.waveform = Some(waveform);
        }
        Ok(result?)
    }

    /// Writes out what is buffered.
    pub fn finish(&mut self) -> anyhow::Result<()> {
        if let Some(waveform) = &mut self.waveform {
            waveform.finish().context("the trace is incomplete")?;
        }
        self.world.finish_candump().context("the log is incomplete")
    }
}

/// The reference board's wiring, as docs/bring-up.md has it.
fn signals() -> Signals {
    let wheels = || WHEELS.iter().enumerate();
    let named = |pins: &[(Port, u8, &str)]| -> Vec<(Port, u8, String)> {
        let pin = |(port, pin, name): &(Port, u8, &str)| (*port, *pin, (*name).to_owned());
        pins.iter().map(pin).collect()
    };
    let mut pins = named(&[
        (Port::B, 0, "driver_enable"),
        (Port::B, 1, "brake_release"),
        (Port::A, 5, "led"),
    ]);
    pins.extend(
        wheels().map(|(index, wheel)| (Port::C, index as u8, format!("direction_{wheel}"))),
    );
    Signals {
        pwm: wheels()
            .map(|(index, wheel)| (1, index + 1, format!("pwm_{wheel}")))
            .collect(),
        pins,
        encoders: wheels()
            .map(|(index, wheel)| (index + 2, format!("encoder_{wheel}")))
            .collect(),
    }
}
