//! Paths that a group can be driven along.
//!
//! A [`course`] is what was asked for: a [`curve`] by name or a [`mod@file`] of points, and how it
//! is to be driven. Its plan gives the pose and the twist at every instant. [`steering`] corrects
//! the twist by measured poses; [`roller_transition`] adds what is lost where one roller takes over
//! from another. A [`route`] is a way that changes while it is driven.

pub mod adaptation;
pub mod course;
pub mod curve;
pub mod file;
pub mod roller_transition;
pub mod route;
pub mod steering;
