//! What the environment says of the network, and how unusable values are refused.

use std::net::IpAddr;

use omnibus_ros::node::environment::{Environment, Reach, Services};

/// Reads an environment of these variables alone.
fn read(variables: &[(&str, &str)]) -> Result<Environment, String> {
    Environment::read(|name| {
        let found = variables.iter().find(|(known, _)| *known == name);
        found.map(|(_, value)| (*value).to_owned())
    })
}

#[test]
fn nothing_said_is_what_ros_does_by_itself() {
    let wanted = Environment {
        domain: 0,
        reach: Reach::Subnet,
        peers: Vec::new(),
        services: Services::FastDds,
    };
    assert_eq!(read(&[]), Ok(wanted.clone()));
    // A variable that is set to nothing says nothing.
    let empty = [
        "ROS_DOMAIN_ID",
        "ROS_LOCALHOST_ONLY",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "ROS_STATIC_PEERS",
        "RMW_IMPLEMENTATION",
    ];
    assert_eq!(read(&empty.map(|name| (name, ""))), Ok(wanted));
}

#[test]
fn every_variable_is_read() {
    let domain = |text| read(&[("ROS_DOMAIN_ID", text)]).unwrap().domain;
    assert_eq!((domain("0"), domain(" 42 "), domain("232")), (0, 42, 232));
    let reach = |name, value| read(&[(name, value)]).unwrap().reach;
    assert_eq!(reach("ROS_LOCALHOST_ONLY", "1"), Reach::Localhost);
    assert_eq!(reach("ROS_LOCALHOST_ONLY", "0"), Reach::Subnet);
    let range = "ROS_AUTOMATIC_DISCOVERY_RANGE";
    assert_eq!(reach(range, "LOCALHOST"), Reach::Localhost);
    assert_eq!(reach(range, "SUBNET"), Reach::Subnet);
    assert_eq!(reach(range, "SYSTEM_DEFAULT"), Reach::Subnet);
    // The older variable goes before the newer one.
    let both = read(&[("ROS_LOCALHOST_ONLY", "1"), (range, "SUBNET")]).unwrap();
    assert_eq!(both.reach, Reach::Localhost);
    let peers = read(&[("ROS_STATIC_PEERS", "10.0.0.5; 10.0.0.6;")]).unwrap();
    let wanted = ["10.0.0.5", "10.0.0.6"].map(|text| text.parse::<IpAddr>().unwrap());
    assert_eq!(peers.peers, wanted);
    let services = |name| read(&[("RMW_IMPLEMENTATION", name)]).unwrap().services;
    assert_eq!(services("rmw_fastrtps_cpp"), Services::FastDds);
    assert_eq!(services("rmw_fastrtps_dynamic_cpp"), Services::FastDds);
    assert_eq!(services("rmw_cyclonedds_cpp"), Services::Cyclone);
}

#[test]
fn unusable_values_are_refused_by_variable_with_what_it_may_be() {
    for (name, value, remedy) in [
        ("ROS_DOMAIN_ID", "233", "0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "0 to 232"),
        ("ROS_DOMAIN_ID", "left", "0 to 232"),
        ("ROS_LOCALHOST_ONLY", "yes", "0 or 1"),
        (
            "ROS_AUTOMATIC_DISCOVERY_RANGE",
            "OFF",
            "SUBNET or LOCALHOST",
        ),
        (
            "RMW_IMPLEMENTATION",
            "rmw_zenoh_cpp",
            "zenoh-bridge-ros2dds",
        ),
        ("ROS_STATIC_PEERS", "no name at all", "between semicolons"),
    ] {
        let error = read(&[(name, value)]).unwrap_err();
        assert!(error.contains(name), "{error}");
        assert!(error.contains(remedy), "{error}");
    }
}
