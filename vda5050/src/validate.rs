//! Validation of an order by itself: chapters 6.6.1 and 6.7, and whether this vehicle can execute
//! it at all (6.6.4.1, 6.6.4.2).

use std::f64::consts::PI;

use crate::Version;
use crate::configuration::Configuration;
use crate::error::{ErrorKind, Refusal};
use crate::message::order::{Edge, Node, NodePosition, Order};
use crate::nurbs::Nurbs;
use crate::relocation::Relocation;

/// Most nodes of one message.
pub const MOST_NODES: usize = 1_000;
/// What 3.141592654 is beyond pi, and a little more.
const ROUNDING: f64 = 1e-6;

/// Checks a whole order.
///
/// `map` is the one on which the order begins; where it `continues` another, its first node was
/// checked before, and what is to be done there is done or awaited already.
pub fn check(
    order: &Order,
    configuration: &Configuration,
    map: &str,
    continues: bool,
) -> Result<(), Refusal> {
    let about = |refusal: Refusal| {
        refusal
            .about("orderId", &order.order_id)
            .about("orderUpdateId", order.order_update_id)
    };
    addressed(order, configuration).map_err(about)?;
    graph(order, configuration.identity.version).map_err(about)?;
    let mut map = map.to_owned();
    for node in order.nodes.iter().skip(usize::from(continues)) {
        let place = |refusal: Refusal| about(refusal.about("nodeId", &node.node_id));
        check_node(node, &map).map_err(place)?;
        if let Some(relocation) = Relocation::on(node).map_err(place)? {
            map = relocation.place.map;
        }
    }
    for edge in &order.edges {
        let way = |refusal: Refusal| about(refusal.about("edgeId", &edge.edge_id));
        check_edge(edge, configuration).map_err(way)?;
    }
    if let Some(zones) = order.zone_set_id.as_deref().filter(|id| !id.is_empty()) {
        let refusal = Refusal::new(
            ErrorKind::UnsupportedParameter,
            format!("zoneSetId: {zones:?}; this vehicle knows no zones, so leave it out"),
        );
        return Err(about(refusal.about("zoneSetId", zones)));
    }
    Ok(())
}

fn malformed(sentence: String) -> Refusal {
    Refusal::new(ErrorKind::Malformed, sentence)
}

fn addressed(order: &Order, configuration: &Configuration) -> Result<(), Refusal> {
    let identity = &configuration.identity;
    if order.serial_number != identity.serial || order.manufacturer != identity.manufacturer {
        return Err(malformed(format!(
            "the order is for {} {}, and this vehicle is {} {}",
            order.manufacturer, order.serial_number, identity.manufacturer, identity.serial
        )));
    }
    Ok(())
}

/// Nodes and edges form one path, whose released part comes first.
fn graph(order: &Order, version: Version) -> Result<(), Refusal> {
    let (nodes, edges) = (&order.nodes, &order.edges);
    let Some(first) = nodes.first() else {
        return Err(malformed("nodes: an order has at least one node".into()));
    };
    if nodes.len() > MOST_NODES {
        return Err(malformed(format!(
            "nodes: {} nodes; at most {MOST_NODES} are accepted in one message, so send the rest \
             as updates",
            nodes.len()
        )));
    }
    if edges.len() + 1 != nodes.len() {
        return Err(malformed(format!(
            "edges: {} edges for {} nodes; there is one edge fewer than nodes",
            edges.len(),
            nodes.len()
        )));
    }
    if !first.released {
        return Err(malformed(format!(
            "nodes[0]: {} is not released; the first node of an order always is",
            first.node_id
        )));
    }
    let mut wanted = first.sequence_id;
    let mut released = true;
    for (index, (edge, pair)) in edges.iter().zip(nodes.windows(2)).enumerate() {
        let [before, after] = pair else { continue };
        numbered(
            edge.sequence_id,
            wanted.checked_add(1),
            "edge",
            &edge.edge_id,
        )?;
        numbered(
            after.sequence_id,
            wanted.checked_add(2),
            "node",
            &after.node_id,
        )?;
        wanted = after.sequence_id;
        connects(edge, before, after, version)?;
        if edge.released && !(before.released && after.released) {
            return Err(malformed(format!(
                "edges[{index}]: {} is released and one of its nodes is not",
                edge.edge_id
            )));
        }
        if !released && (edge.released || after.released) {
            return Err(malformed(format!(
                "edges[{index}]: {} and its end must not be released, because what comes before \
                 is not",
                edge.edge_id
            )));
        }
        if after.released && !edge.released {
            return Err(malformed(format!(
                "nodes[{}]: {} is released, and the edge to it is not",
                index + 1,
                after.node_id
            )));
        }
        released = after.released;
    }
    Ok(())
}

fn numbered(is: u32, wanted: Option<u32>, what: &str, name: &str) -> Result<(), Refusal> {
    match wanted {
        Some(wanted) if wanted == is => Ok(()),
        Some(wanted) => Err(malformed(format!(
            "sequenceId: {what} {name} has {is} where {wanted} follows; nodes and edges are \
             counted together without a gap"
        ))),
        None => Err(malformed(format!(
            "sequenceId: {is} of {what} {name} is too large"
        ))),
    }
}

fn connects(edge: &Edge, before: &Node, after: &Node, version: Version) -> Result<(), Refusal> {
    for (field, named, is) in [
        ("startNodeId", &edge.start_node_id, &before.node_id),
        ("endNodeId", &edge.end_node_id, &after.node_id),
    ] {
        match named {
            None if version < Version::V3_0 => {
                return Err(malformed(format!(
                    "{field}: it is missing in edge {}",
                    edge.edge_id
                )));
            }
            Some(named) if named != is => {
                return Err(malformed(format!(
                    "{field}: edge {} names {named}, but the node there is {is}",
                    edge.edge_id
                )));
            }
            _ => {}
        }
    }
    Ok(())
}

fn check_node(node: &Node, map: &str) -> Result<(), Refusal> {
    let name = &node.node_id;
    let Some(position) = &node.node_position else {
        return Err(Refusal::new(
            ErrorKind::NoRoute,
            format!("node {name} has no nodePosition, and this vehicle drives by positions"),
        ));
    };
    check_position(name, position)?;
    if position.map_id != map {
        return Err(Refusal::new(
            ErrorKind::UnknownMap,
            format!(
                "node {name} is on map {:?}, and this vehicle is on {map:?}",
                position.map_id
            ),
        )
        .about("mapId", &position.map_id));
    }
    Ok(())
}

fn check_position(name: &str, position: &NodePosition) -> Result<(), Refusal> {
    if position.x.abs() > 1e6 || position.y.abs() > 1e6 {
        return Err(malformed(format!(
            "node {name}: ({}, {}) is further than 1000 km away",
            position.x, position.y
        )));
    }
    check_angle(name, "theta", position.theta)?;
    let largest = position
        .allowed_deviation_xy
        .map_or(0.0, |deviation| deviation.largest());
    let theta = position.allowed_deviation_theta.unwrap_or(0.0);
    if largest < 0.0 || theta < 0.0 {
        return Err(malformed(format!(
            "node {name}: an allowed deviation is negative"
        )));
    }
    Ok(())
}

fn check_angle(name: &str, field: &str, angle: Option<f64>) -> Result<(), Refusal> {
    match angle {
        Some(angle) if angle.abs() > PI + ROUNDING => Err(malformed(format!(
            "{name}: {field} is {angle} rad; it must lie between -pi and pi"
        ))),
        _ => Ok(()),
    }
}

fn check_edge(edge: &Edge, configuration: &Configuration) -> Result<(), Refusal> {
    let name = &edge.edge_id;
    check_angle(name, "orientation", edge.orientation)?;
    for (field, value) in [
        ("maxSpeed", edge.max_speed),
        ("maxRotationSpeed", edge.max_rotation_speed),
    ] {
        if let Some(value) = value.filter(|value| *value < 1e-3) {
            return Err(Refusal::new(
                ErrorKind::NoRoute,
                format!("edge {name}: {field} is {value}, so it would never be driven"),
            )
            .about(field, value));
        }
    }
    let unusable = |field: &str, sentence: String| {
        Err(Refusal::new(ErrorKind::UnsupportedParameter, sentence).about("field", field))
    };
    if let Some(direction) = edge.direction.as_deref().filter(|text| !text.is_empty()) {
        let sentence = format!(
            "edge {name}: direction {direction:?} is for line-guided vehicles, and this one moves \
             freely"
        );
        return unusable("direction", sentence);
    }
    let height = configuration.height;
    if let Some(low) = edge.max_height.filter(|low| *low < height) {
        let sentence = format!(
            "edge {name}: maxHeight is {low} m, and this vehicle is {height} m high (--height)"
        );
        return unusable("maxHeight", sentence);
    }
    if let Some(high) = edge.min_height.filter(|high| *high > 0.0) {
        let sentence = format!(
            "edge {name}: minHeight is {high} m, and this vehicle has no load handling device"
        );
        return unusable("minHeight", sentence);
    }
    if let Some(trajectory) = &edge.trajectory {
        Nurbs::new(trajectory)
            .map_err(|why| malformed(format!("edge {name}: trajectory.{why}")))?;
    }
    no_actions(edge)
}

/// On edges this vehicle has no action.
fn no_actions(edge: &Edge) -> Result<(), Refusal> {
    let Some(action) = edge.actions.first() else {
        return Ok(());
    };
    let (name, kind) = (&edge.edge_id, &action.action_type);
    Err(Refusal::new(
        ErrorKind::InvalidOrderAction,
        format!("edge {name}: action {kind}; this vehicle drives and has no actions on edges"),
    )
    .about("actionId", &action.action_id)
    .about("actionType", kind))
}
