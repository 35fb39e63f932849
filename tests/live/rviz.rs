//! The display of a match in `RViz`, on a virtual screen.

use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::graph::{Graph, PACKAGE, Process, within};
use crate::common::skipped::skip;

/// Whether a program is installed. Reports the test as skipped if not.
fn is_there(program: &str) -> bool {
    let there =
        Command::new("sh").args(["-c", &format!("command -v {program}")]).stdout(Stdio::null()).status().unwrap().success();
    if !there {
        skip(&format!("{program} is not installed (apt-get install rviz xvfb imagemagick)"));
    }
    there
}

/// A virtual X server, and the name of its display.
fn screen(graph: &Graph) -> (Process, String) {
    let named = graph.dir.path().join("display");
    let mut command = graph.command("sh");
    let server = format!("exec Xvfb -displayfd 3 -screen 0 1280x900x24 +extension GLX -nolisten tcp 3>{}", named.display());
    command.args(["-c", &server]);
    let server = Process::spawn(command, graph.dir.path());
    let number = || std::fs::read_to_string(&named).unwrap_or_default().trim().to_owned();
    assert!(within(Duration::from_secs(30), || !number().is_empty()), "{}", server.log());
    (server, format!(":{}", number()))
}

/// Numbers of pixels with about the colours of the reference, of the matched points, and of the path.
fn points_of_each_colour(display: &str) -> [usize; 3] {
    const COLOURS: [[u8; 3]; 3] = [[89, 115, 166], [242, 140, 26], [80, 200, 120]];
    let taken = Command::new("import").args(["-window", "root", "-depth", "8", "rgb:-"]).env("DISPLAY", display).output();
    let Ok(pixels) = taken.map(|output| output.stdout) else { return [0; 3] };
    let is_near = |pixel: &[u8], colour: [u8; 3]| pixel.iter().zip(colour).all(|(a, b)| a.abs_diff(b) < 12);
    COLOURS.map(|colour| pixels.chunks_exact(3).filter(|pixel| is_near(pixel, colour)).count())
}

#[test]
fn rviz_shows_reference_matched_points_and_path() {
    if !["rviz", "Xvfb", "import"].into_iter().all(is_there) {
        return;
    }
    let Some(graph) = Graph::start() else { return };
    let (_server, display) = screen(&graph);
    let bag = format!("bag:={PACKAGE}/bags/demo.bag");
    let launch = graph.launch_with(
        "replay.launch",
        &[&bag, "rviz:=true", "rate:=0.3"],
        &[("DISPLAY", &display), ("LIBGL_ALWAYS_SOFTWARE", "1"), ("QT_X11_NO_MITSHM", "1")],
    );
    let mut found = [0; 3];
    let shown = within(Duration::from_secs(90), || {
        std::thread::sleep(Duration::from_secs(1));
        found = points_of_each_colour(&display);
        found.iter().all(|&count| count > 20)
    });
    eprintln!("points of the reference's, the matched points' and the path's colour: {found:?}");
    assert!(shown, "{found:?}: {}", launch.log());
}
