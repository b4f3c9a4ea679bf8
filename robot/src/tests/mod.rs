//! Whole robots on a bus, in virtual time.

mod alone;
mod brake;
mod compensation;
mod encoders;
mod group_rules;
mod identification;
mod interlock;
#[cfg(feature = "update")]
mod lock;
mod neighbours;
mod output_stage;
mod pairs;
mod parted;
mod plan;
mod ranges;
mod reaction;
mod resets;
mod safety;
mod saturation;
mod start;
mod storage;
mod tracking;
#[cfg(feature = "update")]
mod update;
mod wheels;
#[cfg(not(feature = "update"))]
mod without_update;
mod world;
