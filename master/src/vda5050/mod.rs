//! A group as one vehicle of a fleet control: VDA 5050 over MQTT.
//!
//! ```text
//!  broker <--> Broker --messages--> Vehicle (crate vda5050) --requests--> Driver --> Controls
//!                 ^                    |         ^                           |          |
//!                 '---- messages ------'         '--- what is seen --- telemetry <--- Pilot
//! ```
//!
//! The `Vehicle` decides about orders; [`driver::Driver`] turns its requests into a
//! [`crate::path::route`] that the pilot follows like any curve, and reports what is seen.
//! [`broker`] carries messages and moves nothing: while it is away the route goes on to its end,
//! which is the last released node. Who may drive is decided by [`crate::controls`].

pub mod broker;
pub mod driver;
mod localisation;
pub mod physics;

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use ::vda5050::{Configuration, Topic, Vehicle};
use group::GroupFile;

use self::broker::{Broker, Input, ThreadEnded};
use self::driver::{Driver, Localised};
use crate::abort::Abort;
use crate::controls::Controls;
use crate::pilot::Pilot;
use crate::run::DriveError;

/// Longest time between two passes that receive messages and judge telemetry.
const TICK: Duration = Duration::from_millis(20);

/// ms since 1970.
fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |now| u64::try_from(now.as_millis()).unwrap_or(u64::MAX))
}

/// Why the vehicle ended.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The bus or the group.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// The connection to the broker.
    #[error(transparent)]
    Broker(#[from] ThreadEnded),
}

/// Keeps the vehicle going until `abort` is asked for or the bus fails; then the group is ramped
/// down and the connection closed with the word that says so.
///
/// # Errors
/// When the bus cannot be opened or fails, or the broker's connection has failed for good.
pub fn operate(
    pilot: Arc<Pilot>,
    group: &GroupFile,
    configuration: Configuration,
    broker: Broker,
    localised: Localised,
    abort: &Abort,
    report: &dyn Fn(&str),
) -> Result<(), VehicleError> {
    let stream = pilot.telemetry();
    let controls = Controls::of(&pilot, &group.limits);
    let mut driver = Driver::new(group, &controls, localised);
    let mut vehicle = Vehicle::new(configuration);
    let mut connection = Ok(());
    while !abort.is_asked() && !pilot.is_over() && connection.is_ok() {
        if let Some(item) = stream.next_within(TICK) {
            controls.on_telemetry(&item);
            driver.on_telemetry(&item);
            while let Some(item) = stream.try_next() {
                controls.on_telemetry(&item);
                driver.on_telemetry(&item);
            }
        }
        let now = unix_ms();
        loop {
            let input = match broker.next() {
                Ok(Some(input)) => input,
                Ok(None) => break,
                Err(ended) => {
                    connection = Err(ended);
                    break;
                }
            };
            match input {
                Input::Connected => {
                    report("connected to the broker");
                    vehicle.connect(now);
                }
                Input::Disconnected(why) => {
                    report(&format!("no connection to the broker: {why}"));
                    vehicle.disconnect();
                }
                Input::Message(topic, text) => vehicle.receive(topic, &text, now),
            }
            driver.serve(vehicle.requests());
        }
        for mark in driver.passed() {
            vehicle.passed(mark, now);
        }
        vehicle.see(driver.seen(), now);
        driver.serve(vehicle.requests());
        for sent in vehicle.outgoing() {
            broker.send(&sent);
        }
    }
    driver.leave();
    drop(driver);
    broker.close(&vehicle.offline(unix_ms()));
    drop(controls);
    Pilot::finish_shared(pilot)?;
    Ok(connection?)
}

/// Quality of service and retention of a topic (6.2): `connection` has to arrive and is kept; a
/// factsheet is kept for those who come later.
const fn delivery(topic: Topic) -> (rumqttc::QoS, bool) {
    match topic {
        Topic::Connection => (rumqttc::QoS::AtLeastOnce, true),
        Topic::Factsheet => (rumqttc::QoS::AtMostOnce, true),
        Topic::Order | Topic::InstantActions | Topic::State | Topic::Visualization => {
            (rumqttc::QoS::AtMostOnce, false)
        }
    }
}
