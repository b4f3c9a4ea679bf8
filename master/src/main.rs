//! The `omnibus` command.

fn main() {}
