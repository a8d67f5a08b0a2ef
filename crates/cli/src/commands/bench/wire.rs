//! `heliostat bench loop` and `heliostat-lab bench rooms`: from the publication of a report to the
//! arrival of the command that answers it. With `loop --driver` the controller process drives the array
//! too, and the time ends when the device gets the angles.
//!
//! This process is the room, the controller is a second one, and the reference is a third: an echo
//! that answers each report with as many bytes as a command has, over the same session, with the
//! same quality of service. Reports go to controller and echo alternately. A report counts from its
//! due time.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use heliostat_bus::{Bus, BusConfig, Class, Publisher, Reach, Role, Subscription, free_loopback_endpoint};
use heliostat_controller::report::stage_times::BUDGET;
use heliostat_controller::report::summary::Summary;
use heliostat_core::policy::PolicyKind;
use heliostat_models::ActorSource;
use heliostat_proto::{MirrorCommand, Room, decode_into, encode};
use heliostat_scenario::{STUDY_SCENARIO, Scenario, ScenarioArgs};
use heliostat_service::clock::utc_ns;

use super::board::Board;
use super::one_process::{Outcome, instant_of, monotonic_ns};
use super::pace::{Block, PaceArgs, Plan, Turn};
use super::rows::{Row, Table, Varied};
use super::usage::{Router, Usage};
use super::walkers::Walkers;
use crate::commands::demo::child::ChildProcess as Part;

/// Longest time until the other process answers.
const MEET_WITHIN: Duration = Duration::from_secs(20);
/// Longest time until a process ends.
const END_WITHIN: Duration = Duration::from_secs(10);
/// A report without an answer for this long is lost, and counts with this time.
const LOST_AFTER: Duration = Duration::from_millis(500);
/// Unmeasured reports at the start.
const WARM_UP: u64 = 100;
/// Tick of the first measured report, at which the controller's statistics begin. Earlier ticks
/// belong to the warm-up. The users have walked 113 full circles by then, so that they do not jump.
const MEASURED_FROM: u64 = 71_000;
/// The wait ends with a busy-wait of this length, because a sleep ends after its due time.
const SPIN: Duration = Duration::from_micros(100);

/// Flags that the benchmarks across processes share.
#[derive(Debug, clap::Args)]
#[command(mut_arg("scenario", |argument| argument.default_value(STUDY_SCENARIO)))]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    pace: PaceArgs,
    /// Policy of the controller
    #[arg(long, value_enum, default_value_t = PolicyKind::Ddpg)]
    policy: PolicyKind,
    /// Numbers of rooms that one process serves (comma-separated), instead of the benchmark's
    /// default
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u16).range(1..=512))]
    rooms: Vec<u16>,
    /// Controller processes that share the rooms
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=64))]
    controllers: u16,
    /// Zenoh router (the program zenohd) through which all processes exchange their messages, instead
    /// of direct links
    #[arg(long, value_name = "FILE")]
    router: Option<String>,
    /// Endpoint of the processes, instead of a free TCP port of this machine; for example
    /// unixsock-stream//run/bench.sock
    #[arg(long, value_name = "ENDPOINT")]
    endpoint: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Flags for the controller process, after --
    #[arg(last = true, value_name = "FLAGS")]
    controller: Vec<String>,
}

/// Flags of `loop`.
#[derive(Debug, clap::Args)]
pub struct LoopArgs {
    #[command(flatten)]
    shared: Args,
    /// The controller process also drives the array: measure until the device gets the angles
    #[arg(long, conflicts_with = "rooms")]
    driver: bool,
}

/// `loop`: one room at several rates.
pub fn run_loop(args: &LoopArgs) -> Result<()> {
    if args.driver {
        // Fails here rather than in the controller process, at its first command.
        monotonic_ns()?;
    }
    let (title, end) = match args.driver {
        false => ("loop over Zenoh; reference: an echo of the same payload sizes", End::Command),
        true => ("from report to device in one process; reference: an echo, there and back", End::Device),
    };
    args.shared.run(title, &[10.0, 100.0, 1000.0, 0.0], &[1], end)
}

/// Where a measured time ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The command arrives in the process of the room.
    Command,
    /// The device of an array in the controller's process gets the angles.
    Device,
}

/// `rooms`: a growing number of rooms on one controller process.
pub fn run_rooms(args: &Args) -> Result<()> {
    let title = "loop over Zenoh with one controller process for all rooms; reference: an echo for as many";
    args.run(title, &[100.0], &[1, 4, 16, 32, 64], End::Command)
}

impl Args {
    fn run(&self, title: &str, default_hz: &[f64], rooms: &[usize], end: End) -> Result<()> {
        let scenario =
            self.scenario.load().context("the room of this benchmark has one array; bench decide takes several")?;
        // Fails here rather than in the controller process, for whose answer the room would wait.
        heliostat_models::build(self.policy, &scenario, &ActorSource::Shipped)?;
        let named: Vec<usize> = self.rooms.iter().map(|rooms| usize::from(*rooms)).collect();
        let rooms = if named.is_empty() { rooms } else { &named };
        let mut table = Table::new(self.json, title)?;
        for plan in self.pace.plans(default_hz)? {
            for rooms in rooms {
                table.add(self.measure(&plan, &scenario, *rooms, end)?)?;
            }
        }
        Ok(table.finish()?)
    }

    fn measure(&self, plan: &Plan, scenario: &Scenario, rooms: usize, end: End) -> Result<Row> {
        let endpoint = self.endpoint.clone().map_or_else(free_loopback_endpoint, Ok)?;
        let router = self.router.as_ref().map(|program| Router::start(program, &endpoint)).transpose()?;
        let config = BusConfig::new(Room::new("bench")?);
        let config = match router {
            Some(_) => BusConfig { role: Role::Client, ..config.connect_to(&endpoint) },
            None => config.listen_at(&endpoint),
        };
        let bus =
            Bus::open(&config.reaching(if router.is_some() { Reach::Within(MEET_WITHIN) } else { Reach::Eventually }))?;
        let mut measured = Side::open(&bus, "measured", scenario, rooms)?;
        let mut reference = Side::open(&bus, "reference", scenario, rooms)?;
        let controllers = shares(&measured.names, usize::from(self.controllers))
            .map(|names| Part::start("controller", &self.controller_arguments(&endpoint, names, end)))
            .collect::<Result<Vec<Part>>>()?;
        let mut echo = echo_arguments(&endpoint, &reference.names, scenario)?;
        echo.extend(router.iter().map(|_| "--client".to_owned()));
        let echo = Part::start("echo", &echo)?;
        for side in [&mut measured, &mut reference] {
            side.meet()?;
            side.go_through(Block {
                interval: None,
                reports: WARM_UP,
                until: Instant::now() + Duration::from_secs(5),
            })?;
            side.begin()?;
        }
        let (ids, router_id) = (controllers.iter().map(Part::id).collect::<Vec<_>>(), router.as_ref().map(Router::id));
        let (mut used, mut reports) = (Usage::default(), 0);
        plan.take_turns(|turn, block| match turn {
            Turn::Measured => {
                let before = Usage::now(&ids, router_id);
                let sent = measured.go_through(block)?;
                used += Usage::now(&ids, router_id) - before;
                reports += sent;
                Ok(sent)
            }
            Turn::Reference => reference.go_through(block),
        })?;
        let process_count = controllers.len();
        let (mut summaries, mut device) = (Vec::new(), None);
        for controller in controllers {
            let last_line = controller.finish(END_WITHIN)?;
            let incomplete = "the controller's summary is incomplete";
            summaries.push(match end {
                End::Command => serde_json::from_value::<Summary>(last_line).context(incomplete)?,
                End::Device => {
                    let outcome: Outcome = serde_json::from_value(last_line).context(incomplete)?;
                    device = Some(measured.device_board(&outcome.applied)?);
                    outcome.summary
                }
            });
        }
        echo.finish(END_WITHIN)?;
        let over_budget_by = summaries.iter().flat_map(|summary| &summary.over_budget_by).fold(
            BTreeMap::new(),
            |mut sums: BTreeMap<String, u64>, (stage, count)| {
                *sums.entry(stage.clone()).or_default() += count;
                sums
            },
        );
        // All controllers have the same work: the times of the first stand for all.
        let summary = summaries.swap_remove(0);
        bus.close()?;

        let varied = Varied {
            hz: plan.hz,
            mirrors: scenario.mirror_count(),
            users: scenario.users.count,
            rooms,
            controllers: (process_count > 1).then_some(process_count),
            policy: summary.policy,
            engine: summary.engine,
        };
        let (took, lost) = device.as_ref().unwrap_or(&measured.board).take(LOST_AFTER);
        let (compared, _) = reference.board.take(LOST_AFTER);
        ensure!(took.count() > 0 && compared.count() > 0, "no report was answered");
        let row = Row::new(varied, (took.distribution(), took.over(BUDGET), took.count()), &compared);
        let row = row.by_stage(over_budget_by, &summary.stages_us);
        Ok(row.across_processes(lost, summary.decision_us, used.of_a_report(reports)))
    }

    fn controller_arguments(&self, endpoint: &str, rooms: &[String], end: End) -> Vec<String> {
        let command: &[&str] = if end == End::Device { &["bench", "one-process"] } else { &["controller"] };
        let mut arguments: Vec<String> = command
            .iter()
            .copied()
            .chain(["--connect", endpoint, "--policy", &self.policy.name()])
            .chain(["--scenario", &self.scenario.scenario, "--room", &rooms[0]])
            .map(String::from)
            .collect();
        if self.router.is_some() {
            arguments.push("--client".into());
        }
        if rooms.len() > 1 {
            arguments.extend(["--also-room".into(), rooms[1..].join(",")]);
        }
        arguments.push(format!("--times-from-tick={MEASURED_FROM}"));
        for text in &self.scenario.overrides {
            arguments.extend(["--set".into(), text.clone()]);
        }
        arguments.extend(self.scenario.seed.map(|seed| format!("--seed={seed}")));
        arguments.extend(self.controller.iter().cloned());
        arguments
    }
}

/// The rooms of each of `count` processes; fewer processes where there are fewer rooms.
fn shares(names: &[String], count: usize) -> impl Iterator<Item = &[String]> {
    names.chunks(names.len().div_ceil(count))
}

fn echo_arguments(endpoint: &str, rooms: &[String], scenario: &Scenario) -> Result<Vec<String>> {
    let angles = vec![0.1; scenario.mirror_count()];
    let now = utc_ns();
    let command = MirrorCommand {
        epoch: now / 1_000_000,
        sequence: 1000,
        answers: 1000,
        time_ns: now,
        validity_ms: 200,
        roll: angles.clone(),
        yaw: angles,
    };
    let mut payload = Vec::new();
    encode(&command, &mut payload)?;
    let bytes = payload.len().to_string();
    let arguments = ["bench", "echo", "--connect", endpoint, "--rooms", &rooms.join(","), "--bytes", &bytes];
    Ok(arguments.map(String::from).into())
}

/// The rooms of one process.
struct Side {
    names: Vec<String>,
    rooms: Vec<Publishers>,
    board: Board,
    walkers: Walkers,
    users: usize,
    tick: u64,
    /// Tick and due time of each report since the warm-up.
    due: Vec<(u64, Instant)>,
    /// Whether the payloads are messages; the echo gets payloads of the same size with a number in
    /// front.
    sends_messages: bool,
    buffers: [Vec<u8>; 3],
    _subscriptions: Vec<Subscription>,
}

/// Publishers of one room's reports.
struct Publishers {
    users: Publisher,
    channel: Publisher,
    obstacles: Publisher,
}

impl Side {
    fn open(bus: &Bus, name: &str, scenario: &Scenario, rooms: usize) -> Result<Self> {
        let names: Vec<String> = (1..=rooms).map(|index| format!("{name}-{index}")).collect();
        let board = Board::default();
        let sends_messages = name == "measured";
        let (mut publishers, mut subscriptions) = (Vec::new(), Vec::new());
        for name in &names {
            let room = Room::new(name)?;
            publishers.push(Publishers {
                users: bus.publisher(&room.users(), Class::RealTimeDrop)?,
                channel: bus.publisher(&room.channel(), Class::RealTimeDrop)?,
                obstacles: bus.publisher(&room.obstacles(), Class::RealTimeDrop)?,
            });
            let board = board.clone();
            let mut command = MirrorCommand::default();
            subscriptions.push(bus.subscribe(&room.command(), move |payload| {
                let arrived = Instant::now();
                let tick = if sends_messages {
                    decode_into(&mut command, payload).ok().map(|()| command.answers)
                } else {
                    payload.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
                };
                board.answered(tick.unwrap_or_default(), arrived);
            })?);
        }
        let users = scenario.users.count;
        let (walkers, buffers) = (Walkers::default(), Default::default());
        Ok(Self {
            names,
            rooms: publishers,
            board,
            walkers,
            users,
            tick: 0,
            due: Vec::new(),
            sends_messages,
            buffers,
            _subscriptions: subscriptions,
        })
    }

    /// Sends reports to each room until it answers.
    fn meet(&mut self) -> Result<()> {
        for room in 0..self.rooms.len() {
            let deadline = Instant::now() + MEET_WITHIN;
            loop {
                ensure!(
                    Instant::now() < deadline,
                    "room {} gives no answer: its process runs but receives no reports; expected an answer within {} s",
                    self.names[room],
                    MEET_WITHIN.as_secs()
                );
                self.prepare()?;
                self.rooms[room].obstacles.put(&self.buffers[2])?;
                self.send(room, Instant::now())?;
                if self.board.wait(self.tick, Duration::from_millis(50)) {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Ends the warm-up: what follows is measured, here and in the controller.
    fn begin(&mut self) -> Result<()> {
        ensure!(self.tick < MEASURED_FROM, "the warm-up took {} reports, expected below {MEASURED_FROM}", self.tick);
        self.tick = MEASURED_FROM - 1;
        self.board.begin(MEASURED_FROM);
        self.due.clear();
        Ok(())
    }

    /// The same reports, answered when the device got the angles: tick and monotonic time in ns.
    fn device_board(&self, applied: &[(u64, u64)]) -> Result<Board> {
        let board = Board::default();
        board.begin(MEASURED_FROM);
        self.due.iter().for_each(|(tick, due)| board.sent(*tick, 0, *due));
        for (tick, time_ns) in applied {
            board.answered(*tick, instant_of(*time_ns)?);
        }
        Ok(board)
    }

    /// Sends the reports of a block, room after room, spread evenly over the interval; returns
    /// their number.
    fn go_through(&mut self, block: Block) -> Result<u64> {
        let rooms = self.rooms.len();
        let start = Instant::now();
        let mut sent = 0;
        while sent < block.reports * rooms as u64 {
            self.prepare()?;
            let due = match block.interval {
                None => Instant::now(),
                Some(interval) => start + interval.mul_f64((sent + 1) as f64 / rooms as f64),
            };
            wait_until(due);
            self.send(sent as usize % rooms, due)?;
            sent += 1;
            if block.interval.is_none() {
                self.board.wait(self.tick, LOST_AFTER);
                if Instant::now() > block.until {
                    break;
                }
            }
        }
        self.board.wait(self.tick, LOST_AFTER);
        Ok(sent)
    }

    /// Encodes the payloads of the next tick.
    fn prepare(&mut self) -> Result<()> {
        self.tick += 1;
        self.walkers.walk(1, self.tick, utc_ns(), self.users);
        encode(&self.walkers.users, &mut self.buffers[0])?;
        encode(&self.walkers.channel, &mut self.buffers[1])?;
        encode(&self.walkers.obstacles, &mut self.buffers[2])?;
        if !self.sends_messages {
            self.buffers[0][..8].copy_from_slice(&self.tick.to_le_bytes());
        }
        Ok(())
    }

    fn send(&mut self, room: usize, due: Instant) -> Result<()> {
        self.board.sent(self.tick, room, due);
        self.due.push((self.tick, due));
        self.rooms[room].channel.put(&self.buffers[1])?;
        Ok(self.rooms[room].users.put(&self.buffers[0])?)
    }
}

fn wait_until(due: Instant) {
    let left = due.saturating_duration_since(Instant::now());
    if left > SPIN {
        std::thread::sleep(left - SPIN);
    }
    while Instant::now() < due {
        std::hint::spin_loop();
    }
}
