//! The README shows the example as it is, and it is as short as promised.

const README: &str = include_str!("../README.md");
const EXAMPLE: &str = include_str!("../examples/device.rs");

#[test]
fn the_device_of_the_readme_is_the_example() {
    assert!(README.contains(EXAMPLE));
    assert!(EXAMPLE.lines().count() <= 40);
}
