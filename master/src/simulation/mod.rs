//! A simulated world in this process: [`link`] makes a bus of it, [`contact`] prepares groups for its contact plant.

pub mod contact;
pub mod link;
