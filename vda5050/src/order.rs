//! The order that a vehicle holds, and its progress in it (6.6.2, 6.10.2).

use std::collections::VecDeque;

use kinematics::Pose;

use crate::error::{ErrorKind, Refusal};
use crate::leg::{self, Leg};
use crate::message::order::{Edge, Node, NodePosition, Order};
use crate::relocation::Relocation;

/// An order, or what is left of it. It is kept until the next one.
#[derive(Clone, Debug)]
pub struct Held {
    pub id: String,
    pub update: u32,
    /// Nodes that are not traversed yet, horizon included.
    pub nodes: VecDeque<Node>,
    /// Edges that are not left yet, horizon included.
    pub edges: VecDeque<Edge>,
    /// It was cancelled: no update is accepted any more.
    pub cancelled: bool,
    /// The last node of the base, where an update goes on.
    decision: Node,
    /// Where the base ends on the map.
    end: Pose<f64>,
    /// Where the base ends after `initPosition` on its last node.
    moved: Option<NodePosition>,
    /// `initPosition` on nodes of the base that is not done yet, with the ways behind.
    relocations: VecDeque<Relocation>,
    /// What the last message said, to recognise it.
    nodes_received: Vec<Node>,
    edges_received: Vec<Edge>,
}

impl Held {
    /// Takes an order that begins where the vehicle stands, and the legs of its base.
    pub fn new(order: Order, here: Pose<f64>, tolerance: f64) -> Result<(Self, Vec<Leg>), Refusal> {
        let Order {
            order_id,
            order_update_id,
            nodes,
            edges,
            ..
        } = order;
        let Some(first) = nodes.first() else {
            return Err(Refusal::new(ErrorKind::Malformed, "nodes: there are none"));
        };
        let mut held = Self {
            id: order_id,
            update: order_update_id,
            nodes: VecDeque::new(),
            edges: VecDeque::new(),
            cancelled: false,
            decision: first.clone(),
            end: here,
            moved: None,
            relocations: VecDeque::new(),
            nodes_received: Vec::new(),
            edges_received: Vec::new(),
        };
        // One place alone may still ask for a heading.
        let mut legs = Vec::new();
        if let Some(position) = &first.node_position {
            legs.extend(leg::turn_at(here, position).filter(|_| edges.is_empty()));
        }
        let begins = Relocation::on(first)?.map(|relocation| Relocation {
            first: true,
            ..relocation
        });
        legs.extend(held.append(nodes, edges, tolerance, begins)?);
        Ok((held, legs))
    }

    /// Whether this message says what the last accepted one said.
    pub fn repeats(&self, order: &Order) -> bool {
        self.nodes_received == order.nodes && self.edges_received == order.edges
    }

    /// Whether anything is left to be driven, or to be released.
    pub fn is_active(&self) -> bool {
        !self.nodes.is_empty() || !self.relocations.is_empty()
    }

    /// The map on which the base ends, where `initPosition` on a node says so.
    pub fn map(&self) -> Option<&str> {
        let last = self.relocations.back();
        last.map(|relocation| relocation.place.map.as_str())
    }

    /// Identifiers and types of actions that wait for their nodes, those of the horizon too.
    pub fn awaited(&self) -> Vec<(String, String)> {
        let base = self.relocations.iter();
        let horizon = self.nodes.iter().filter(|node| !node.released);
        let horizon = horizon.flat_map(|node| &node.actions);
        base.map(|relocation| relocation.action.clone())
            .chain(horizon.map(|action| (action.action_id.clone(), action.action_type.clone())))
            .collect()
    }

    /// Whether the order begins with `initPosition` that is not done yet.
    pub fn begins_with_relocation(&self) -> bool {
        let next = self.relocations.front();
        next.is_some_and(|relocation| relocation.first)
    }

    /// What is to be done at this node, once.
    pub fn relocate(&mut self, sequence: u32) -> Option<Relocation> {
        let here = self.relocations.front()?.sequence == sequence;
        here.then(|| self.relocations.pop_front()).flatten()
    }

    /// Goes on from the last released node (6.6.2). The horizon is replaced.
    pub fn update(&mut self, order: Order, tolerance: f64) -> Result<Vec<Leg>, Refusal> {
        let Some(first) = order.nodes.first() else {
            return Err(Refusal::new(ErrorKind::Malformed, "nodes: there are none"));
        };
        let (node, number) = (&self.decision.node_id, self.decision.sequence_id);
        if (&first.node_id, first.sequence_id) != (node, number) {
            return Err(Refusal::new(
                ErrorKind::UpdateDoesNotContinue,
                format!(
                    "the update begins at node {} (sequenceId {}), and the last released node is \
                     {node} (sequenceId {number})",
                    first.node_id, first.sequence_id
                ),
            )
            .about("nodeId", &first.node_id));
        }
        let update = order.order_update_id;
        let legs = self.append(order.nodes, order.edges, tolerance, None)?;
        self.update = update;
        Ok(legs)
    }

    /// Puts nodes and edges behind the base, of which the first node is already part. Gives what is
    /// driven before any `initPosition`.
    fn append(
        &mut self,
        nodes: Vec<Node>,
        edges: Vec<Edge>,
        tolerance: f64,
        begins: Option<Relocation>,
    ) -> Result<Vec<Leg>, Refusal> {
        let (mut legs, mut at, mut moved) = (Vec::new(), self.end, self.moved.clone());
        let mut decision = self.decision.clone();
        let mut relocations: Vec<Relocation> = Vec::new();
        if let Some(relocation) = begins {
            at = relocation.place.pose;
            moved = Some(relocation.place.position());
            relocations.push(relocation);
        }
        for (edge, pair) in edges.iter().zip(nodes.windows(2)) {
            let [before, after] = pair else { continue };
            if !edge.released {
                // The horizon is checked as far as it can be without the way there.
                continue;
            }
            let from = moved.take().or_else(|| before.node_position.clone());
            let driven = self.way(edge, (before, from), after, at, tolerance)?;
            at = driven.last().and_then(Leg::end).unwrap_or(at);
            match relocations.last_mut() {
                Some(relocation) => relocation.legs.extend(driven),
                None => legs.extend(driven),
            }
            decision = after.clone();
            if let Some(relocation) = Relocation::on(after)? {
                at = relocation.place.pose;
                moved = Some(relocation.place.position());
                relocations.push(relocation);
            }
        }
        if let Some(before) = self.relocations.back_mut() {
            before.legs.append(&mut legs);
        }
        self.relocations.extend(relocations);
        self.nodes.retain(|node| node.released);
        self.edges.retain(|edge| edge.released);
        self.nodes.extend(nodes.iter().skip(1).cloned());
        self.edges.extend(edges.iter().cloned());
        (self.end, self.decision, self.moved) = (at, decision, moved);
        (self.nodes_received, self.edges_received) = (nodes, edges);
        Ok(legs)
    }

    fn way(
        &self,
        edge: &Edge,
        (before, from): (&Node, Option<NodePosition>),
        after: &Node,
        at: Pose<f64>,
        tolerance: f64,
    ) -> Result<Vec<Leg>, Refusal> {
        let place = |node: &Node, found: Option<NodePosition>| -> Result<NodePosition, Refusal> {
            let sentence = || format!("node {} has no nodePosition", node.node_id);
            found.ok_or_else(|| Refusal::new(ErrorKind::NoRoute, sentence()))
        };
        let (from, to) = (
            place(before, from)?,
            place(after, after.node_position.clone())?,
        );
        leg::legs(edge, &from, &to, at, after.sequence_id, tolerance).map_err(|why| {
            Refusal::new(ErrorKind::NoRoute, format!("edge {}: {why}", edge.edge_id))
                .about("edgeId", &edge.edge_id)
                .about("orderId", &self.id)
        })
    }

    /// The node with this number was traversed; gives it, and forgets what lies before it.
    pub fn pass(&mut self, sequence: u32) -> Option<Node> {
        let place = self
            .nodes
            .iter()
            .position(|node| node.sequence_id == sequence)?;
        let node = self.nodes.drain(..=place).next_back()?;
        self.edges.retain(|edge| edge.sequence_id > sequence);
        Some(node)
    }

    /// Nothing of it will be driven any more.
    pub fn cancel(&mut self) {
        self.nodes.clear();
        self.edges.clear();
        self.relocations.clear();
        self.cancelled = true;
    }

    /// Whether the last released edge is being driven and a horizon waits behind it (6.10.3).
    pub fn wants_base(&self) -> bool {
        let released = self.nodes.iter().filter(|node| node.released).count();
        released <= 1 && self.nodes.len() > released
    }
}
