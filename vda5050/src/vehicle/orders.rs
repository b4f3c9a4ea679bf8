//! Whether an order or an update is accepted: figure 8 of chapter 6.6.2, and 6.6.4.

use kinematics::Pose;

use super::{MOST_REMEMBERED, Request, Vehicle};
use crate::error::{ErrorKind, Refusal};
use crate::leg::Leg;
use crate::message::order::{NodePosition, Order};
use crate::message::state::{ActionStatus, OperatingMode};
use crate::order::Held;
use crate::{Version, message, validate};

impl Vehicle {
    pub(super) fn take_order(&mut self, text: &[u8]) {
        let kind = ErrorKind::Malformed;
        let taken = message::read(text, kind).and_then(|order| self.decide(order));
        match taken {
            Ok(false) => {}
            Ok(true) => {
                self.refusals.clear();
                self.await_actions();
                self.changed = true;
            }
            Err(refusal) => self.refuse(refusal),
        }
    }

    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.refusals.retain(|known| *known != refusal);
        if self.refusals.len() >= MOST_REMEMBERED {
            self.refusals.remove(0);
        }
        self.refusals.push(refusal);
        self.changed = true;
    }

    /// Accepts an order or an update (`true`), knows it already (`false`), or refuses it (6.6.2,
    /// figure 8).
    fn decide(&mut self, order: Order) -> Result<bool, Refusal> {
        let (id, number) = (order.order_id.clone(), order.order_update_id);
        let named = |refusal: Refusal| {
            let known = refusal.references.iter().any(|(key, _)| key == "orderId");
            let refusal = if known {
                refusal
            } else {
                refusal.about("orderId", &id)
            };
            let known = refusal
                .references
                .iter()
                .any(|(key, _)| key == "orderUpdateId");
            if known {
                refusal
            } else {
                refusal.about("orderUpdateId", number)
            }
        };
        let held = self.order.as_ref();
        if let Some(held) = held.filter(|held| held.id == order.order_id)
            && let Some(known) = self.is_known(held, &order).map_err(named)?
        {
            return Ok(known);
        }
        let continued = held.filter(|held| held.id == order.order_id);
        let map = continued.and_then(Held::map).unwrap_or(&self.map);
        validate::check(&order, &self.configuration, map, continued.is_some()).map_err(named)?;
        self.check_available().map_err(named)?;
        let taken = match &self.order {
            Some(held) if held.id == order.order_id => self.extend(order),
            _ => self.begin(order),
        };
        taken.map_err(named)?;
        Ok(true)
    }

    /// Steps 5 and 6 of figure 8: an update that is old, or there already.
    fn is_known(&self, held: &Held, order: &Order) -> Result<Option<bool>, Refusal> {
        let (is, was) = (order.order_update_id, held.update);
        let id = &held.id;
        if is == was {
            if held.repeats(order) || self.configuration.identity.version < Version::V3_0 {
                return Ok(Some(false));
            }
            return Err(Refusal::new(
                ErrorKind::SameUpdateId,
                format!("order {id} has update {is} already, with other content; count it up"),
            ));
        }
        if is < was {
            return Err(Refusal::new(
                ErrorKind::OutdatedUpdate,
                format!("update {is} of order {id} is older than update {was}, which is executed"),
            ));
        }
        if held.cancelled || self.is_cancelling() {
            return Err(Refusal::new(
                ErrorKind::UpdateAfterCancel,
                format!("order {id} was cancelled; send a new one with another orderId"),
            ));
        }
        Ok(None)
    }

    fn check_available(&self) -> Result<(), Refusal> {
        let by = match self.seen.mode {
            OperatingMode::Automatic => return Ok(()),
            OperatingMode::Manual => "by hand",
            OperatingMode::Service => "by another program on its bus",
        };
        let sentence = format!("the vehicle is driven {by}; send the order when that has ended");
        Err(Refusal::new(ErrorKind::NotAvailable, sentence))
    }

    fn extend(&mut self, order: Order) -> Result<(), Refusal> {
        if self.seen.interrupted {
            return Err(Refusal::new(
                ErrorKind::NotAvailable,
                format!(
                    "the drive of order {} was interrupted; cancel it and send a new order",
                    order.order_id
                ),
            ));
        }
        let tolerance = self.configuration.tolerance;
        let Some(held) = &mut self.order else {
            return Ok(());
        };
        let legs = held.update(order, tolerance)?;
        self.drive(legs, false);
        Ok(())
    }

    fn begin(&mut self, order: Order) -> Result<(), Refusal> {
        if let Some(held) = self.order.as_ref().filter(|held| held.is_active()) {
            return Err(Refusal::new(
                ErrorKind::OtherOrderActive,
                format!(
                    "order {} is being executed; cancel it, or wait for its end",
                    held.id
                ),
            ));
        }
        if self.is_cancelling() || self.seen.driving {
            return Err(Refusal::new(
                ErrorKind::OtherOrderActive,
                "the vehicle has not come to rest yet; send the order again when it has",
            ));
        }
        if self.configuration.identity.version == Version::V3_0 && order.order_update_id != 0 {
            return Err(Refusal::new(
                ErrorKind::UpdateDoesNotContinue,
                format!(
                    "orderUpdateId: a new order begins with 0, and this one with {}",
                    order.order_update_id
                ),
            ));
        }
        let first = order.nodes.first();
        let at = first.and_then(|node| Some((node, node.node_position.as_ref()?)));
        let here = match at {
            Some((node, position)) => self.check_start(&node.node_id, position)?,
            None => return Err(Refusal::new(ErrorKind::NoRoute, "nodes[0] has no position")),
        };
        let start = first.map(|node| (node.node_id.clone(), node.sequence_id));
        let (held, legs) = Held::new(order, here, self.configuration.tolerance)?;
        self.order = Some(held);
        self.last_node = start.unwrap_or_default();
        self.actions
            .retain(|action| action.status == ActionStatus::Running);
        self.drive(legs, true);
        Ok(())
    }

    pub(super) fn drive(&mut self, legs: Vec<Leg>, fresh: bool) {
        if !legs.is_empty() {
            self.requests.push(Request::Drive { legs, fresh });
        }
    }

    /// The vehicle stands on the first node, or close enough (6.6.1).
    fn check_start(&self, name: &str, node: &NodePosition) -> Result<Pose<f64>, Refusal> {
        let out = |sentence: String| {
            Refusal::new(ErrorKind::StartOutOfRange, sentence).about("nodeId", name)
        };
        let Some(here) = self.seen.pose else {
            return Err(out(
                "the vehicle does not know where it is; send initPosition".into(),
            ));
        };
        let (dx, dy) = (here.x - node.x, here.y - node.y);
        let least = self.configuration.tolerance;
        let near = node
            .allowed_deviation_xy
            .map_or(dx.hypot(dy) <= least, |allowed| {
                allowed.holds(dx, dy, least)
            });
        if near {
            return Ok(here);
        }
        Err(out(format!(
            "the vehicle is {:.2} m from node {name}, where the order begins; begin where it is, \
             or allow a larger deviation",
            dx.hypot(dy)
        )))
    }
}
