//! Threads that run several robots through the same step of time.
//!
//! Robots do not touch each other within a step, so they may run at the same time without any
//! difference in what they do. A robot is handed over whole and comes back with its result; nothing
//! is shared. This pays only for emulated robots, which compute for tens of microseconds a step;
//! the handing over takes about one, as long as the other side is still looking for work. Who waits
//! looks for a while and then sleeps, so that an idle world costs no processor.

use std::sync::mpsc::{Receiver, RecvError, Sender, TryRecvError, channel};
use std::thread::JoinHandle;

use canopen::Frame;

use crate::error::SimError;
use crate::motor::Bridge;
use crate::robot::{Robot, Wake};

/// How often to look before going to sleep: some tens of microseconds.
const LOOKS: u32 = 2_000;

/// A robot and the time to run it to.
struct Job {
    place: usize,
    robot: Box<dyn Robot>,
    until_ns: u64,
}

/// A robot that has been run.
struct Done {
    place: usize,
    robot: Box<dyn Robot>,
    result: Result<(), SimError>,
}

struct Worker {
    jobs: Option<Sender<Job>>,
    thread: Option<JoinHandle<()>>,
}

/// The threads.
pub(crate) struct WorkerPool {
    workers: Vec<Worker>,
    done: Receiver<Done>,
}

impl WorkerPool {
    /// This many threads beside the caller's.
    pub fn new(threads: usize) -> Self {
        let (send_done, done) = channel();
        let workers = (0..threads)
            .map(|_| {
                let (jobs, inbox) = channel();
                let outbox = send_done.clone();
                let thread = std::thread::spawn(move || work(&inbox, &outbox));
                Worker {
                    jobs: Some(jobs),
                    thread: Some(thread),
                }
            })
            .collect();
        Self { workers, done }
    }

    /// Runs robots to a time, the first of every round on this thread.
    pub fn run(
        &self,
        robots: Vec<(usize, Box<dyn Robot>)>,
        until_ns: u64,
        back: &mut impl FnMut(usize, Box<dyn Robot>),
    ) -> Result<(), SimError> {
        let hands = self.workers.len() + 1;
        let mut mine = Vec::new();
        let mut away = 0;
        for (turn, (place, robot)) in robots.into_iter().enumerate() {
            let job = Job {
                place,
                robot,
                until_ns,
            };
            let worker = (turn % hands)
                .checked_sub(1)
                .and_then(|n| self.workers.get(n));
            match worker.and_then(|worker| worker.jobs.as_ref()) {
                // A worker that is gone gives the job back.
                Some(jobs) => match jobs.send(job) {
                    Ok(()) => away += 1,
                    Err(refused) => mine.push(refused.0),
                },
                None => mine.push(job),
            }
        }
        let mut first: Option<(usize, SimError)> = None;
        let mut finish = |done: Done| {
            back(done.place, done.robot);
            if let Err(error) = done.result
                && first.as_ref().is_none_or(|(place, _)| done.place < *place)
            {
                first = Some((done.place, error));
            }
        };
        for job in mine {
            finish(job.run());
        }
        for _ in 0..away {
            match wait(&self.done) {
                Ok(done) => finish(done),
                Err(_) => break,
            }
        }
        first.map_or(Ok(()), |(_, error)| Err(error))
    }
}

impl Drop for WorkerPool {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            worker.jobs = None;
            if let Some(thread) = worker.thread.take() {
                // A panic in a robot has been seen as a closed channel already.
                let _ = thread.join();
            }
        }
    }
}

impl Job {
    fn run(mut self) -> Done {
        let result = self.robot.run_until(self.until_ns);
        Done {
            place: self.place,
            robot: self.robot,
            result,
        }
    }
}

/// Stands in the world for a robot that another thread runs. Should that thread fail, this stays,
/// and the world stops at its next step.
pub(crate) struct Absent;

impl Robot for Absent {
    fn run_until(&mut self, time_ns: u64) -> Result<(), SimError> {
        let problem = "the thread that ran it has failed".to_owned();
        Err(SimError::Stopped {
            node: 0,
            time_ns,
            problem,
        })
    }

    fn wake(&self) -> Wake {
        Wake::Never
    }

    fn pending(&self) -> Option<Frame> {
        None
    }

    fn transmitted(&mut self) {}
    fn lost_arbitration(&mut self) {}
    fn receive(&mut self, _: &Frame) {}

    fn drives(&self) -> [Bridge; 4] {
        [Bridge::default(); 4]
    }

    fn turn_encoders(&mut self, _: [i32; 4]) {}
    fn set_emergency_stop(&mut self, _: bool) {}
    fn set_driver_fault(&mut self, _: bool) {}
    fn set_power(&mut self, _: bool) {}
}

fn work(inbox: &Receiver<Job>, outbox: &Sender<Done>) {
    while let Ok(job) = wait(inbox) {
        if outbox.send(job.run()).is_err() {
            break;
        }
    }
}

/// Looks for a while, then sleeps until something comes.
fn wait<T>(from: &Receiver<T>) -> Result<T, RecvError> {
    for _ in 0..LOOKS {
        match from.try_recv() {
            Ok(item) => return Ok(item),
            Err(TryRecvError::Disconnected) => return Err(RecvError),
            Err(TryRecvError::Empty) => std::hint::spin_loop(),
        }
    }
    from.recv()
}
