//! Instant actions (6.8, 6.9): each is answered, also one that cannot be done.

use kinematics::Pose;
use serde_json::Value;

use super::{MOST_REMEMBERED, Request, Vehicle};
use crate::error::{ErrorKind, Refusal};
use crate::message::action::{Action, InstantActions};
use crate::message::state::{ActionState, ActionStatus};
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
            if self.actions.len() >= MOST_REMEMBERED {
                self.actions.remove(0);
            }
            self.actions.push(ActionState {
                id: action.action_id.clone(),
                kind: action.action_type.clone(),
                status,
                result: done.as_ref().err().map(|refusal| refusal.sentence.clone()),
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
                    .retain(|action| action.status == ActionStatus::Running);
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
        let number = |key: &str| {
            let value = action.parameter(key).and_then(Value::as_f64);
            let value = value.filter(|value| value.abs() <= 1e6);
            value.ok_or_else(|| wrong(format!("initPosition: {key} is missing or no number")))
        };
        let text = |key: &str| action.parameter(key).and_then(Value::as_str);
        let pose = Pose::new(number("x")?, number("y")?, number("theta")?);
        if pose.heading.abs() > std::f64::consts::PI + 1e-6 {
            return Err(wrong(
                "initPosition: theta must lie between -pi and pi".into(),
            ));
        }
        let map = text("mapId").filter(|map| !map.is_empty());
        let map = map.ok_or_else(|| wrong("initPosition: mapId is missing or no text".into()))?;
        map.clone_into(&mut self.map);
        self.last_node = (text("lastNodeId").unwrap_or_default().to_owned(), 0);
        self.seen.pose = Some(pose);
        self.requests.push(Request::SetPosition(pose));
        Ok(ActionStatus::Finished)
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
        self.changed = true;
    }
}
