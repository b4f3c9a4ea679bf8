//! Translates the vehicle's requests into commands to the group, and the group's state back.
//!
//! A request to drive becomes a [`SharedRoute`]. The robots are started for it, and the route is
//! handed to the pilot when they follow setpoints. More legs are put behind it while it is driven;
//! when it has just ended they become the next one.

use ::vda5050::leg::Leg;
use ::vda5050::message::state::{OperatingMode, VehicleError};
use ::vda5050::{Request, Seen};
use canopen::Micros;
use group::GroupFile;
use kinematics::{Pose, Twist};
use protocol::{Code, Fault, Limit};

use super::localisation::Localisation;
use crate::controls::Controls;
use crate::controls::arbiter::Client;
use crate::monitor::telemetry::{EventKind, MemberSample, SessionState, Snapshot, Telemetry};
use crate::path::route::{SharedRoute, Stretch};
use crate::path::steering::Law;
use crate::pilot::Errand;
use crate::session::follow::lead;
use crate::source::pose::PoseStream;

/// Slower than this the group stands, m/s and rad/s.
const STANDSTILL: f32 = 0.01;

/// Where poses come from, and where that is on the map.
pub struct Localised {
    /// Poses from outside; `None`: the robots' own wheels.
    pub poses: Option<PoseStream>,
    /// Where the frame of the poses lies on the map, or where the group stands at the start.
    pub offset: Option<Pose<f64>>,
    /// How poses correct a drive.
    pub law: Law,
}

/// What is being driven.
enum Drive {
    /// Nothing.
    None,
    /// The robots are being started for these legs.
    Starting(Vec<Stretch>),
    /// A route, and what comes behind it when it has ended.
    Route(SharedRoute, Vec<Stretch>),
}

/// Drives a group for a vehicle.
pub struct Driver<'a> {
    group: &'a GroupFile,
    controls: &'a Controls,
    client: Client,
    poses: Option<PoseStream>,
    law: Law,
    place: Localisation,
    drive: Drive,
    paused: bool,
    running: bool,
    mode: OperatingMode,
    velocity: Option<Twist>,
    faults: Vec<VehicleError>,
    emergency_stop: bool,
    supply_low: bool,
    /// What ended the last drive.
    failed: Option<String>,
}

impl<'a> Driver<'a> {
    /// A driver that has not asked for the controls yet.
    #[must_use]
    pub fn new(group: &'a GroupFile, controls: &'a Controls, localised: Localised) -> Self {
        let Localised { poses, offset, law } = localised;
        let place = match (&poses, offset) {
            (Some(_), offset) => Localisation::with_offset(offset.unwrap_or_default()),
            (None, Some(offset)) => {
                let mut place = Localisation::default();
                place.set(offset);
                place
            }
            (None, None) => Localisation::default(),
        };
        Self {
            group,
            controls,
            client: controls.client(),
            poses,
            law,
            place,
            drive: Drive::None,
            paused: false,
            running: false,
            mode: OperatingMode::Automatic,
            velocity: None,
            faults: Vec::new(),
            emergency_stop: false,
            supply_low: false,
            failed: None,
        }
    }

    /// Does what the vehicle asks for.
    pub fn serve(&mut self, requests: Vec<Request>) {
        for request in requests {
            match request {
                Request::Drive { legs, fresh } => {
                    if fresh {
                        self.failed = None;
                    }
                    self.begin(legs.into_iter().map(stretch).collect());
                }
                Request::Pause => {
                    self.paused = true;
                    if let Drive::Route(route, _) = &self.drive {
                        route.hold();
                    }
                }
                Request::Resume => {
                    self.paused = false;
                    if let Drive::Route(route, _) = &self.drive {
                        route.resume();
                    }
                }
                Request::Stop => match &mut self.drive {
                    Drive::None => {}
                    Drive::Starting(_) => self.drive = Drive::None,
                    Drive::Route(route, behind) => {
                        behind.clear();
                        route.cut();
                    }
                },
                Request::SetPosition(pose) => self.place.set(pose),
            }
        }
    }

    fn begin(&mut self, stretches: Vec<Stretch>) {
        match &mut self.drive {
            Drive::Starting(waiting) => waiting.extend(stretches),
            Drive::Route(route, behind) => {
                if !behind.is_empty() || !route.extend(&stretches) {
                    behind.extend(stretches);
                }
            }
            Drive::None => {
                let (controls, client) = (self.controls, self.client);
                match controls.take(client).and_then(|()| controls.start(client)) {
                    Ok(()) => self.drive = Drive::Starting(stretches),
                    Err(why) => self.failed = Some(why),
                }
            }
        }
    }

    /// Takes in what the group does.
    pub fn on_telemetry(&mut self, item: &Telemetry) {
        match item {
            Telemetry::Snapshot(snapshot) => self.on_snapshot(snapshot),
            Telemetry::Event(event) => {
                if let EventKind::Failed(why) = &event.what {
                    self.failed = Some(why.clone());
                    if matches!(self.drive, Drive::Starting(_)) {
                        self.drive = Drive::None;
                    }
                }
            }
            Telemetry::Frame(_) => {}
        }
    }

    fn on_snapshot(&mut self, snapshot: &Snapshot) {
        self.running = snapshot.phase == SessionState::Running;
        self.velocity = snapshot.measured;
        let by_hand = self.controls.has_driver() && !self.controls.drives(self.client);
        self.mode = match (snapshot.foreign_master, by_hand) {
            (true, _) => OperatingMode::Service,
            (false, true) => OperatingMode::Manual,
            (false, false) => OperatingMode::Automatic,
        };
        let seen = match &self.poses {
            Some(poses) => poses.latest(Micros(0)).map(|(_, pose)| pose),
            None => snapshot.pose,
        };
        if let Some(Pose { x, y, heading }) = seen {
            self.place
                .see(Pose::new(x.into(), y.into(), heading.into()));
        }
        let codes = || {
            snapshot
                .members
                .iter()
                .map(|member| (member.node, code(member)))
        };
        self.faults = codes()
            .filter_map(|(node, code)| fault(node, code))
            .collect();
        let has = |wanted: Code| codes().any(|(_, code)| code == wanted);
        self.emergency_stop = has(Code::Fault(Fault::EmergencyStop));
        self.supply_low = has(Code::Limit(Limit::Supply)) || has(Code::Fault(Fault::SupplyLow));
        self.go_on();
    }

    /// Hands a waiting way to the pilot, and lets go of one that is driven no more.
    fn go_on(&mut self) {
        match std::mem::replace(&mut self.drive, Drive::None) {
            Drive::Starting(stretches) if self.running => self.follow(stretches),
            Drive::Route(route, behind) if route.is_closed() && route.is_reported() => {
                if !behind.is_empty() && self.running {
                    self.follow(behind);
                }
            }
            Drive::Route(route, behind) => {
                if let Err(why) = self.controls.keep_following(self.client) {
                    // Whoever stopped the robots did so at the pilot, too.
                    self.failed.get_or_insert(why);
                }
                self.drive = Drive::Route(route, behind);
            }
            other => self.drive = other,
        }
    }

    fn follow(&mut self, stretches: Vec<Stretch>) {
        let Some(here) = self.place.pose() else {
            self.failed = Some("the group does not know where it is; send initPosition".into());
            return;
        };
        let lead = lead(self.group);
        let route = SharedRoute::new(&self.group.limits, &stretches, lead, self.paused);
        #[expect(clippy::cast_possible_truncation, reason = "the follower is f32")]
        let start = Pose::new(here.x as f32, here.y as f32, here.heading as f32);
        let errand = Errand {
            route: route.clone(),
            start,
            law: self.law,
            poses: self.poses.clone(),
        };
        match self.controls.follow(self.client, errand) {
            Ok(()) => self.drive = Drive::Route(route, Vec::new()),
            Err(why) => self.failed = Some(why),
        }
    }

    /// Nodes that were passed since the last call.
    #[must_use]
    pub fn passed(&mut self) -> Vec<u32> {
        match &self.drive {
            Drive::Route(route, _) => route.passed(),
            Drive::None | Drive::Starting(_) => Vec::new(),
        }
    }

    /// What is seen of the group.
    #[must_use]
    pub fn seen(&self) -> Seen {
        let moves = self
            .velocity
            .is_some_and(|v| v.vx.hypot(v.vy) > STANDSTILL || v.omega.abs() > STANDSTILL);
        let busy = match &self.drive {
            Drive::None => false,
            Drive::Starting(_) => !self.paused,
            Drive::Route(route, _) => !route.stands(),
        };
        let mut errors = self.faults.clone();
        if let Some(why) = &self.failed {
            errors.push(VehicleError {
                kind: "groupStopped".into(),
                sentence: format!(
                    "{why}; cancel the order, remove the cause, and send a new order"
                ),
                fatal: true,
                references: Vec::new(),
            });
        }
        Seen {
            pose: self.place.pose(),
            velocity: self
                .velocity
                .map(|v| Twist::new(v.vx.into(), v.vy.into(), v.omega.into())),
            driving: busy || moves,
            errors,
            interrupted: self.failed.is_some(),
            emergency_stop: self.emergency_stop,
            supply_low: self.supply_low,
            mode: self.mode,
        }
    }

    /// Leaves the controls; the group is ramped down if it was driven.
    pub fn leave(&self) {
        self.controls.gone(self.client);
    }
}

/// What a member says of itself, or said last.
fn code(member: &MemberSample) -> Code {
    match (member.code, member.past) {
        (Code::None, Some(past)) if matches!(past.code, Code::Fault(_)) => past.code,
        (code, _) => code,
    }
}

fn fault(node: u8, code: Code) -> Option<VehicleError> {
    let Code::Fault(fault) = code else {
        return None;
    };
    Some(VehicleError {
        kind: fault.name().into(),
        sentence: format!("node {node}:{}", fault.text()),
        fatal: true,
        references: vec![("node".into(), node.to_string())],
    })
}

fn stretch(leg: Leg) -> Stretch {
    let Leg {
        poses,
        max_speed,
        max_turn,
        arrives,
    } = leg;
    Stretch {
        poses,
        speed: max_speed,
        turn: max_turn,
        mark: arrives,
    }
}
