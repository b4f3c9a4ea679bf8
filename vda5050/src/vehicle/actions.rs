//! Instant actions (6.8, 6.9): each is answered, even one that cannot be executed.

use serde_json::Value;

use super::{MOST_REMEMBERED, Request, Vehicle};
use crate::error::{ErrorKind, Refusal};
use crate::message::action::{Action, InstantActions};
use crate::message::state::{ActionState, ActionStatus};
use crate::order::Held;
use crate::relocation::Place;
use crate::{Version, message};

impl Vehicle {
    pub(super) fn take_actions(&mut self, text: &[u8], now: u64) {
        let kind = ErrorKind::MalformedInstantAction;
        let message: InstantActions = match message::read(text, kind) {
            Ok(message) => message,
            Err(refusal) => return self.refuse(refusal.about("topic", "instantActions")),
        };
        for action in &message.actions {
            // The same message may come twice.
            if self
                .actions
                .iter()
                .any(|known| known.id == action.action_id)
            {
                continue;
            }
            let done = self.act(action, now);
            let status = *done.as_ref().unwrap_or(&ActionStatus::Failed);
            self.remember(ActionState {
                id: action.action_id.clone(),
                kind: action.action_type.clone(),
                status,
                result: done.as_ref().err().map(|refusal| refusal.sentence.clone()),
                ordered: false,
            });
            if let Err(refusal) = done {
                self.refuse(refusal.about("actionId", &action.action_id));
            }
            self.changed = true;
        }
    }

    /// Does an instant action, or says why not.
    fn act(&mut self, action: &Action, now: u64) -> Result<ActionStatus, Refusal> {
        match action.action_type.as_str() {
            "startPause" => {
                self.paused = true;
                self.requests.push(Request::Pause);
                Ok(ActionStatus::Running)
            }
            "stopPause" => {
                self.paused = false;
                self.requests.push(Request::Resume);
                Ok(ActionStatus::Finished)
            }
            "cancelOrder" => self.begin_cancel(action),
            "initPosition" | "initializePosition" => self.set_position(action),
            "stateRequest" => Ok(ActionStatus::Finished),
            "factsheetRequest" => {
                self.send_factsheet(now);
                Ok(ActionStatus::Finished)
            }
            "clearInstantActions" if self.configuration.identity.version == Version::V3_0 => {
                self.actions
                    .retain(|action| action.ordered || action.status == ActionStatus::Running);
                Ok(ActionStatus::Finished)
            }
            other => Err(Refusal::new(
                ErrorKind::InvalidInstantAction,
                format!(
                    "this vehicle has no action {other:?}; it has startPause, stopPause, \
                     cancelOrder, initPosition, stateRequest and factsheetRequest"
                ),
            )
            .about("actionType", other)),
        }
    }

    fn begin_cancel(&mut self, action: &Action) -> Result<ActionStatus, Refusal> {
        let held = self.order.as_ref().filter(|held| held.is_active());
        let wanted = action.parameter("orderId").and_then(Value::as_str);
        match (held, wanted) {
            (Some(held), Some(wanted)) if held.id != wanted => Err(Refusal::new(
                ErrorKind::NoOrderToCancel,
                format!("order {wanted} is not being executed; order {} is", held.id),
            )),
            (None, _) => Err(Refusal::new(
                ErrorKind::NoOrderToCancel,
                "there is no order to cancel",
            )),
            (Some(_), _) => {
                self.requests.push(Request::Stop);
                Ok(ActionStatus::Running)
            }
        }
    }

    fn set_position(&mut self, action: &Action) -> Result<ActionStatus, Refusal> {
        let wrong = |sentence: String| Refusal::new(ErrorKind::InvalidInstantAction, sentence);
        if self.seen.driving || self.is_busy() {
            return Err(wrong(
                "initPosition: an order is being executed; cancel it first".into(),
            ));
        }
        let place = Place::of(action).map_err(wrong)?;
        self.last_node = (place.last_node.clone().unwrap_or_default(), 0);
        self.stands_at(place);
        Ok(ActionStatus::Finished)
    }

    fn stands_at(&mut self, place: Place) {
        self.map = place.map;
        self.seen.pose = Some(place.pose);
        self.requests.push(Request::SetPosition(place.pose));
    }

    /// Remembers an action; the oldest that has ended goes for it.
    fn remember(&mut self, action: ActionState) {
        if self.actions.len() >= MOST_REMEMBERED {
            let ended = |action: &ActionState| action.status != ActionStatus::Waiting;
            let oldest = self.actions.iter().position(ended).unwrap_or(0);
            self.actions.remove(oldest);
        }
        self.actions.push(action);
    }

    /// Shows the actions on nodes ahead, and forgets those that an update has taken away.
    pub(super) fn await_actions(&mut self) {
        let awaited = self.order.as_ref().map(Held::awaited).unwrap_or_default();
        self.actions.retain(|action| {
            action.status != ActionStatus::Waiting || awaited.iter().any(|(id, _)| *id == action.id)
        });
        for (id, kind) in awaited {
            if self.actions.iter().all(|known| known.id != id) {
                self.remember(ActionState {
                    id,
                    kind,
                    status: ActionStatus::Waiting,
                    result: None,
                    ordered: true,
                });
            }
        }
    }

    /// Does `initPosition` on the node where the vehicle has come to rest, and drives on.
    pub(super) fn relocate(&mut self) {
        if self.paused || self.seen.driving || !self.requests.is_empty() {
            return;
        }
        let Some(order) = self.order.as_mut() else {
            return;
        };
        if self.seen.interrupted && !order.begins_with_relocation() {
            return;
        }
        let Some(relocation) = order.relocate(self.last_node.1) else {
            return;
        };
        if let Some(name) = relocation.place.last_node.clone() {
            self.last_node.0 = name;
        }
        self.stands_at(relocation.place);
        self.drive(relocation.legs, relocation.first);
        let (id, _) = relocation.action;
        for action in self.actions.iter_mut().filter(|action| action.id == id) {
            action.status = ActionStatus::Finished;
        }
        self.changed = true;
    }

    pub(super) fn is_cancelling(&self) -> bool {
        self.actions
            .iter()
            .any(|action| action.kind == "cancelOrder" && action.status == ActionStatus::Running)
    }

    pub(super) fn drop_order(&mut self) {
        if let Some(order) = &mut self.order {
            order.cancel();
        }
        for action in &mut self.actions {
            if action.status == ActionStatus::Waiting {
                action.status = ActionStatus::Failed;
                action.result = Some("the order was cancelled".into());
            }
        }
        self.changed = true;
    }
}
