//! Whole robots on a bus, in virtual time.

mod compensation;
mod group_rules;
mod identification;
mod neighbours;
mod pairs;
mod reaction;
mod safety;
mod start;
mod storage;
mod tracking;
mod wheels;
mod world;
