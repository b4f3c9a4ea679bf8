//! The master PC: drives a group of robots over one CAN bus.
