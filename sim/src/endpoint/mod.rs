//! Ways onto the virtual bus, and into the world, for other programs.
//!
//! Everything here is an [`Endpoint`]: it says where it is, and between two slices of virtual time
//! it takes in what programs have sent and hands out what has happened. None of them waits for
//! a client, but for [`lockstep`], which holds time for its clients: what a client does not read is
//! kept for a while, and then the client loses frames or its connection, because a bus does not
//! wait for slow listeners either. So an endpoint decides *when*, in virtual time, a program's
//! frames reach the bus; a run with programs outside is only as repeatable as they are.
//!
//! | endpoint | who speaks it |
//! |---|---|
//! | [`lockstep`]: a bus whose time waits for its clients | `omnibus` |
//! | [`slcan_tcp`]: slcan over TCP | `omnibus`, python-can (`slcan`, `socket://`) |
//! | [`pty`]: slcan over a pseudo terminal | slcand, python-can (`slcan`), everything for serial adapters |
//! | [`cable`]: the serial port of an emulated robot | the same, and tests of the firmware's answers |
//! | [`socketcand`]: socketcand in raw mode | python-can (`socketcand`), Wireshark, Kayak |
//! | [`socket_can`]: a Linux CAN interface | can-utils, python-can, everything for Linux |
//! | [`pose`]: true poses as lines of JSON | what would listen to a motion-capture system |
//! | [`gyro`]: samples of the robots' gyros as lines of JSON | what would listen to real ones |
//! | [`replay`]: a candump log in | none: it plays a file |

#[cfg(unix)]
pub mod cable;
pub mod gyro;
pub mod json_lines;
pub mod lockstep;
pub mod pose;
#[cfg(unix)]
pub mod pty;
pub mod replay;
pub mod slcan;
pub mod slcan_tcp;
#[cfg(target_os = "linux")]
pub mod socket_can;
pub mod socketcand;
mod stream;
#[cfg(unix)]
pub mod terminal;

use std::io;
use std::time::Duration;

use canopen::Micros;

use crate::world::World;
pub use stream::Listener;

/// A way into the world for programs outside.
pub trait Endpoint {
    /// What it is and where, in one line: `slcan-tcp 127.0.0.1:7701`.
    fn announce(&self) -> String;

    /// Takes in what programs have sent and hands out what has happened. To be called often; it
    /// never waits.
    ///
    /// # Errors
    /// When the endpoint itself is lost, not when a client is.
    fn exchange(&mut self, world: &mut World) -> io::Result<()>;

    /// How far time may go, now that it is `now`, before this endpoint is asked again; `None` for
    /// one that does not hold time.
    fn limit(&self, _now: Micros) -> Option<Micros> {
        None
    }

    /// Where its clients connect.
    fn listener(&self) -> Option<&Listener> {
        None
    }

    /// Waits until a program has said something, or one has connected to one of these, and so long
    /// at most. For one that holds time.
    fn wait(&self, _listeners: &[&Listener], most: Duration) {
        std::thread::sleep(most);
    }
}
