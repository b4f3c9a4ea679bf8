//! Whole robots on a bus, in virtual time.

mod group_rules;
mod reaction;
mod safety;
mod start;
mod storage;
mod tracking;
mod world;
