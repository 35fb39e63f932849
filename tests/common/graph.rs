//! A separate ROS graph for each test: a master on a free port, and everything that the test starts is ended with it. Tests that
//! mostly wait run in parallel; those that measure times, or drive fast, have the machine to themselves.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::skipped::skip;

pub const PACKAGE: &str = env!("CARGO_MANIFEST_DIR");
pub const NODE: &str = env!("CARGO_BIN_EXE_scan_matcher");
const PROGRAMS: [&str; 6] = [
    NODE,
    env!("CARGO_BIN_EXE_mapper"),
    env!("CARGO_BIN_EXE_particle_filter"),
    env!("CARGO_BIN_EXE_path_follower"),
    env!("CARGO_BIN_EXE_contract_demo"),
    env!("CARGO_BIN_EXE_racecar_sim"),
];
/// Timeout for anything that should happen soon; long because the machine may be loaded.
pub const TIMEOUT: Duration = Duration::from_secs(20);

/// Waits until `condition` holds; `false` if it times out.
pub fn eventually(condition: impl FnMut() -> bool) -> bool {
    within(TIMEOUT, condition)
}

pub fn within(time: Duration, mut condition: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !condition() {
        if start.elapsed() > time {
            return false;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    true
}

/// Whether `program` is installed. In CI its absence is a failure; elsewhere the test is reported as skipped.
pub fn installed(program: &str) -> bool {
    let found = std::env::var_os("PATH").is_some_and(|path| std::env::split_paths(&path).any(|dir| dir.join(program).is_file()));
    if !found {
        assert!(std::env::var("CI").as_deref() != Ok("true"), "{program} is not installed, and this is CI");
        skip(&format!("{program} is not installed"));
    }
    found
}

/// The tests of this program share the machine, except those that measure times or drive fast.
static MACHINE: RwLock<()> = RwLock::new(());

/// A test's share of the machine.
enum Turn {
    Beside { _others: RwLockReadGuard<'static, ()> },
    Alone { _machine: RwLockWriteGuard<'static, ()> },
}

impl Turn {
    fn beside_others() -> Self {
        Self::Beside { _others: MACHINE.read().unwrap_or_else(PoisonError::into_inner) }
    }

    fn alone() -> Self {
        Self::Alone { _machine: MACHINE.write().unwrap_or_else(PoisonError::into_inner) }
    }
}

/// A port that nobody listens on. It is outside the range that the system assigns by itself (from 32768 on), so that nobody else gets it
/// while a master is down.
fn free_port() -> u16 {
    const FIRST: u32 = 20_000;
    const PORTS: u32 = 10_000;
    static TAKEN: AtomicU32 = AtomicU32::new(0);
    // Test programs that run at the same time start at different ports.
    let begin = std::process::id().wrapping_mul(997);
    let ports = (0..PORTS).map(|_| FIRST + begin.wrapping_add(TAKEN.fetch_add(1, Ordering::Relaxed)) % PORTS);
    let mut ports = ports.map(|port| u16::try_from(port).unwrap());
    ports.find(|&port| TcpListener::bind(("localhost", port)).is_ok()).unwrap()
}

pub struct Graph {
    pub dir: TempDir,
    port: u16,
    master: Option<Process>,
    // Last: it is dropped when everything else has ended.
    _turn: Turn,
}

impl Graph {
    /// A graph without a master. `None` if ROS is not installed.
    pub fn without_master() -> Option<Self> {
        Self::new(Turn::beside_others)
    }

    pub fn start() -> Option<Self> {
        Self::without_master().map(Self::with_master)
    }

    /// Without a master, and with the machine to itself: for tests that measure times or drive fast.
    pub fn alone_without_master() -> Option<Self> {
        Self::new(Turn::alone)
    }

    /// The same, with a master.
    pub fn alone() -> Option<Self> {
        Self::alone_without_master().map(Self::with_master)
    }

    fn with_master(mut self) -> Self {
        self.start_master();
        self
    }

    fn new(turn: fn() -> Turn) -> Option<Self> {
        if !installed("roscore") {
            return None;
        }
        let turn = turn();
        Some(Self { dir: TempDir::new().unwrap(), port: free_port(), master: None, _turn: turn })
    }

    /// Starts roscore's master; roscore itself would start it in a new session, where it outlives a failing test.
    pub fn start_master(&mut self) {
        let port = self.port.to_string();
        self.master = Some(self.spawn("rosmaster", &["--core", "-p", &port]));
        let address = self.master_address();
        assert!(eventually(|| TcpStream::connect(&address).is_ok()), "no master: {}", self.master.as_ref().unwrap().log());
    }

    pub fn stop_master(&mut self) {
        self.master = None;
    }

    /// A command with the environment of this graph, without the variables that cargo sets for the build.
    pub fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new(program);
        command
            .current_dir(self.dir.path())
            .env("PWD", self.dir.path()) // catkin_make uses this
            .env_remove("ROSRUST_MSG_PATH")
            .env_remove("CMAKE_PREFIX_PATH")
            .env_remove("ROS_NAMESPACE")
            .env_remove("ROS_IP")
            .env_remove("ROS_DISTRO")
            .env("ROS_PACKAGE_PATH", format!("{PACKAGE}:/usr/share"))
            .env("ROS_MASTER_URI", format!("http://localhost:{}", self.port))
            .env("ROS_HOSTNAME", "localhost")
            .env("ROS_HOME", self.dir.path().join("ros"))
            .env("PYTHONUNBUFFERED", "1");
        command
    }

    pub fn spawn(&self, program: &str, arguments: &[&str]) -> Process {
        let mut command = self.command(program);
        command.args(arguments);
        Process::spawn(command, self.dir.path())
    }

    /// Standard output of a command that succeeds.
    pub fn output(&self, program: &str, arguments: &[&str]) -> String {
        let output = self.command(program).args(arguments).output().unwrap();
        assert!(output.status.success(), "{program} {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a launch file of this package, with a target directory whose release build contains the programs under test.
    pub fn launch(&self, file: &str, arguments: &[&str]) -> Process {
        self.launch_with(file, arguments, &[])
    }

    /// The same, with additional environment variables.
    pub fn launch_with(&self, file: &str, arguments: &[&str], variables: &[(&str, &str)]) -> Process {
        let release = self.dir.path().join("target/release");
        fs::create_dir_all(&release).unwrap();
        for program in PROGRAMS.map(Path::new) {
            let link = release.join(program.file_name().unwrap());
            if !link.exists() {
                std::os::unix::fs::symlink(program, link).unwrap();
            }
        }
        let mut command = self.command("roslaunch");
        command.env("CARGO_TARGET_DIR", release.parent().unwrap()).envs(variables.iter().copied());
        command.args(["anytime_scan_matcher", file]).args(arguments);
        Process::spawn(command, self.dir.path())
    }

    /// Starts the node without waiting.
    pub fn spawn_node(&self, arguments: &[&str]) -> Process {
        self.spawn(NODE, arguments)
    }

    /// Starts the node and waits until it is ready.
    pub fn node(&self, arguments: &[&str]) -> Process {
        let node = self.spawn_node(arguments);
        node.expect_log("; poses on ");
        node
    }

    /// Starts to record `topics`; [`Self::finish_recording`] ends it.
    pub fn record(&self, topics: &[&str]) -> Process {
        let mut arguments = vec!["record", "-O", "recorded.bag"];
        arguments.extend(topics);
        let links = || self.master_state().matches("/record_").count();
        let before = links(); // of one that ended without unregistering from the master
        let recorder = self.spawn("rosbag", &arguments);
        assert!(eventually(|| links() >= before + topics.len()), "{}", recorder.log());
        recorder
    }

    /// Publishers, subscribers and services: the master's answer, in XML.
    pub fn master_state(&self) -> String {
        self.call_master("getSystemState", &["/test"])
    }

    /// The address of a node's XML-RPC server.
    pub fn node_address(&self, node: &str) -> String {
        let answer = self.call_master("lookupNode", &["/test", node]);
        answer.split("http://").nth(1).unwrap().split('/').next().unwrap().into()
    }

    /// Host and port of a service.
    pub fn service_address(&self, name: &str) -> String {
        let answer = self.call_master("lookupService", &["/test", name]);
        answer.split("rosrpc://").nth(1).unwrap().split(['/', '<', ']']).next().unwrap().into()
    }

    pub fn master_address(&self) -> String {
        format!("localhost:{}", self.port)
    }

    /// The master's answer, in XML, to a call with these strings.
    pub fn call_master(&self, method: &str, arguments: &[&str]) -> String {
        let values: Vec<String> = arguments.iter().map(|text| format!("<string>{text}</string>")).collect();
        call(&self.master_address(), method, &values)
    }

    /// Ends a recording and returns its bag.
    pub fn finish_recording(&self, mut recorder: Process) -> PathBuf {
        std::thread::sleep(Duration::from_millis(500)); // for messages still in transit
        // `rosbag record` is a script around the recorder, and ends before the recorder has closed its file and given it its final name.
        recorder.signal_group("INT");
        let recorded = self.dir.path().join("recorded.bag");
        assert!(recorder.exit_code(TIMEOUT).is_some() && eventually(|| recorded.exists()), "{}", recorder.log());
        // Rename it, so that the next recording can use the name.
        let bag = tempfile::Builder::new().suffix(".bag").tempfile_in(self.dir.path()).unwrap().keep().unwrap().1;
        fs::rename(recorded, &bag).unwrap();
        bag
    }

    /// Calls a `std_srvs/Trigger` that must succeed; returns its message.
    pub fn trigger(&self, service: &str) -> String {
        let (success, message) = self.call(service);
        assert!(success, "{message}");
        message
    }

    /// Calls a `std_srvs/Trigger` by TCPROS directly, because its Python types may not be installed.
    pub fn call(&self, service: &str) -> (bool, String) {
        let answer = self.request(service, "std_srvs/Trigger", "937c9679a518e3a18d831e57125ea522", &[]);
        (answer[0] == 1, String::from_utf8(answer[5..].to_vec()).unwrap())
    }

    /// The serialised response of a service to a request.
    pub fn request(&self, service: &str, service_type: &str, md5: &str, request: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(self.service_address(service)).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let field = |text: String| [u32::try_from(text.len()).unwrap().to_le_bytes().to_vec(), text.into_bytes()].concat();
        let header = [
            field(format!("service={service}")),
            field("callerid=/test".into()),
            field(format!("md5sum={md5}")),
            field(format!("type={service_type}")),
        ]
        .concat();
        stream.write_all(&u32::try_from(header.len()).unwrap().to_le_bytes()).unwrap();
        stream.write_all(&header).unwrap();
        stream.write_all(&u32::try_from(request.len()).unwrap().to_le_bytes()).unwrap();
        stream.write_all(request).unwrap();
        let block = |stream: &mut TcpStream| {
            let mut length = [0; 4];
            stream.read_exact(&mut length).unwrap();
            let mut bytes = vec![0; u32::from_le_bytes(length) as usize];
            stream.read_exact(&mut bytes).unwrap();
            bytes
        };
        block(&mut stream);
        let mut ok = [0];
        stream.read_exact(&mut ok).unwrap();
        let answer = block(&mut stream);
        assert_eq!(ok[0], 1, "the service failed");
        answer
    }
}

/// The answer of an XML-RPC server to a call with these values.
pub fn call(address: &str, method: &str, values: &[String]) -> String {
    let values = values.iter().map(|value| format!("<param><value>{value}</value></param>")).collect::<Vec<_>>().concat();
    let body =
        format!("<?xml version='1.0'?><methodCall><methodName>{method}</methodName><params>{values}</params></methodCall>");
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "POST /RPC2 HTTP/1.0\r\nContent-Type: text/xml\r\nContent-Length: {}\r\n\r\n{body}", body.len()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// A process in its own process group, which is ended with it.
pub struct Process {
    child: Child,
    log: PathBuf,
}

impl Process {
    pub fn spawn(mut command: Command, dir: &Path) -> Self {
        let log = tempfile::Builder::new().suffix(".log").tempfile_in(dir).unwrap().keep().unwrap().1;
        let file = File::create(&log).unwrap();
        command.process_group(0).stdin(Stdio::null()).stdout(file.try_clone().unwrap()).stderr(file);
        Self { child: command.spawn().unwrap(), log }
    }

    /// Its output so far.
    pub fn log(&self) -> String {
        String::from_utf8_lossy(&fs::read(&self.log).unwrap()).into_owned()
    }

    pub fn expect_log(&self, text: &str) {
        assert!(eventually(|| self.log().contains(text)), "'{text}' is missing in: {}", self.log());
    }

    pub fn signal(&self, name: &str) {
        send(name, &self.child.id().to_string());
    }

    pub fn signal_group(&self, name: &str) {
        send(name, &format!("-{}", self.child.id()));
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Its exit code, if it ends by itself in time.
    pub fn exit_code(&mut self, timeout: Duration) -> Option<i32> {
        let mut status = None;
        within(timeout, || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.and_then(|status| status.code())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The processes of roslaunch are in their own groups: only roslaunch can end them.
        if self.is_running() {
            self.signal("TERM");
            self.exit_code(TIMEOUT);
        }
        if self.is_running() {
            self.signal_group("KILL");
            let _ = self.child.wait();
        }
    }
}

fn send(signal: &str, to: &str) {
    let _ = Command::new("kill").args(["-s", signal, "--", to]).stderr(Stdio::null()).status();
}
