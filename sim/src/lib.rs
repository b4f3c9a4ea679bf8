//! A virtual CAN bus, plants, and robots native or emulated.
