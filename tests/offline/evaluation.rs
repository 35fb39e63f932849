//! Evaluation of trajectories against the truth, through the public interface, on synthetic paths and on the relations of real logs.

use std::path::Path;
use std::process::{Command, Output};

use anytime_scan_matcher::evaluation::association::{MatchedPose, associate};
use anytime_scan_matcher::evaluation::ate::ate;
use anytime_scan_matcher::evaluation::plot::trajectory_plot;
use anytime_scan_matcher::evaluation::relations::{RelationErrors, relation_errors};
use anytime_scan_matcher::evaluation::rpe::rpe;
use anytime_scan_matcher::evaluation::statistics::PoseErrors;
use anytime_scan_matcher::evaluation::trajectory::{StampedPose, Trajectory};
use anytime_scan_matcher::geometry::{Point, Pose2, wrap_angle};
use anytime_scan_matcher::io::{relations, tum};
use anytime_scan_matcher::time::Stamp;
use proptest::prelude::*;
use serde_json::Value;

use crate::common::program::anytime;
use crate::common::shared;
use crate::common::skipped::skip;

const EPOCH_NS: i64 = 1_795_374_577_083_470_347;

/// A drive along a winding lane, with a pose every 25 ms.
fn drive(poses: usize) -> Trajectory {
    let pose_at = |i: usize| {
        let s = 0.05 * i as f64;
        Pose2::new(s, 2.0 * (0.3 * s).sin(), f64::atan2(0.6 * (0.3 * s).cos(), 1.0))
    };
    let stamped = |i: usize| StampedPose {
        stamp: Stamp::from_nanoseconds(EPOCH_NS + 25_000_000 * i64::try_from(i).unwrap()),
        pose: pose_at(i),
    };
    Trajectory::new((0..poses).map(stamped).collect()).unwrap()
}

fn mapped(trajectory: &Trajectory, change: impl Fn(&StampedPose) -> StampedPose) -> Trajectory {
    Trajectory::new(trajectory.poses().iter().map(change).collect()).unwrap()
}

fn compare(estimate: &Trajectory, truth: &Trajectory) -> Vec<MatchedPose> {
    associate(estimate, truth, 0.1).unwrap()
}

fn poses() -> impl Strategy<Value = Pose2> {
    (-500.0..500.0, -500.0..500.0, -3.1..3.1).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
}

mod metrics {
    use super::*;

    proptest! {
        #[test]
        fn alignment_recovers_any_motion_and_leaves_no_error(motion in poses()) {
            let truth = drive(300);
            let moved = mapped(&truth, |p| StampedPose { pose: motion * p.pose, ..*p });
            let matched = compare(&moved, &truth);
            let ate = ate(&matched).unwrap();
            prop_assert!(ate.errors.trans_m.max < 1e-10 && ate.errors.rot_deg.max < 1e-10);
            let back = ate.truth_from_estimate * motion;
            prop_assert!(back.distance() < 1e-9 && back.theta.abs() < 1e-12, "{back:?}");
            let drift = rpe(&matched, 1.0).unwrap();
            prop_assert!(drift.trans_m.max < 1e-10 && drift.rot_deg.max < 1e-10);
        }

        #[test]
        fn no_other_alignment_is_better(noise in prop::collection::vec(poses(), 10), other in poses()) {
            let matched: Vec<_> = drive(10)
                .poses()
                .iter()
                .zip(&noise)
                .map(|(p, noise)| MatchedPose { stamp: p.stamp, estimate: *noise, truth: p.pose })
                .collect();
            let best = ate(&matched).unwrap();
            let small = Pose2::new(1e-3 * other.x, 1e-3 * other.y, 1e-2 * other.theta);
            for rival in [other, best.truth_from_estimate * small] {
                let square: f64 =
                    matched.iter().map(|m| ((rival * m.estimate).translation() - m.truth.translation()).norm_squared()).sum();
                prop_assert!(best.errors.trans_m.rmse <= (square / 10.0).sqrt() * (1.0 + 1e-12));
            }
        }
    }

    #[test]
    fn the_truth_is_interpolated_to_the_stamps_of_the_estimate() {
        let truth = drive(300);
        // Halfway between two true poses, where a nearest-pose association would be off by 2.5 cm.
        let between = truth.poses().windows(2).map(|pair| StampedPose {
            stamp: pair[0].stamp.offset_by(0.0125),
            pose: pair[0].pose.interpolate(&pair[1].pose, 0.5),
        });
        let estimate = Trajectory::new(between.collect()).unwrap();
        assert!(ate(&compare(&estimate, &truth)).unwrap().errors.trans_m.max < 1e-6);
    }

    #[test]
    fn poses_without_nearby_truth_are_left_out() {
        let (whole, part) = (drive(400), drive(300));
        assert_eq!(compare(&whole, &part).len(), 300);
        let holed =
            Trajectory::new(part.poses().iter().enumerate().filter(|(i, _)| !(100..150).contains(i)).map(|(_, p)| *p).collect());
        assert_eq!(compare(&whole, &holed.unwrap()).len(), 250 + 8); // 0.1 s are 4 poses at either end of the hole
    }

    #[test]
    fn different_clocks_are_an_error_that_shows_both() {
        let truth = drive(3);
        let other = mapped(&truth, |p| StampedPose { stamp: Stamp::from_nanoseconds(p.stamp.nanoseconds() - EPOCH_NS), ..*p });
        let message = associate(&other, &truth, 0.1).unwrap_err().to_string();
        assert!(message.starts_with("only 0 of 3 poses have a true pose within 0.1 s"), "{message}");
        assert!(message.contains("from 0.000000000 to 0.050000000 s"), "{message}");
        assert!(message.contains("1795374577.083470347"), "{message}");
    }
}

mod files {
    use super::*;

    fn tum_error(text: &str) -> String {
        tum::parse(text, Path::new("drive.tum")).unwrap_err().to_string()
    }

    fn relations_error(text: &str) -> String {
        relations::parse(text, Path::new("lab.relations")).unwrap_err().to_string()
    }

    fn written(trajectory: &Trajectory) -> String {
        let mut bytes = Vec::new();
        let mut writer = tum::TumWriter::new(&mut bytes);
        trajectory.poses().iter().for_each(|p| writer.write(p).unwrap());
        writer.flush().unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_pose_is_one_line_of_eight_columns() {
        let pose = StampedPose { stamp: Stamp::from_nanoseconds(EPOCH_NS), pose: Pose2::new(1.5, -2.0, std::f64::consts::PI) };
        let line = "1795374577.083470347 1.500000000 -2.000000000 0 0 0 1.000000000000 0.000000000000\n";
        assert_eq!(written(&Trajectory::new(vec![pose]).unwrap()), line);
    }

    #[test]
    fn both_formats_comments_blank_lines_and_crlf_are_read() {
        let three_forms = [
            "# x y theta\n\n 1.000000001 1 2 0.5\r\n2 3 4 -0.5",
            "1.000000001 1 2 9 0 0 0.24740395925452294 0.9689124217106447\n2 3 4 9 0 0 -0.24740395925452294 0.9689124217106447",
            "2e0 3 4 -0.5\n1000000001e-9 1 2 0.5",
        ];
        for text in three_forms {
            let trajectory = tum::parse(text, Path::new("")).unwrap();
            let [first, second] = trajectory.poses() else { unreachable!("two poses") };
            assert_eq!((first.stamp.nanoseconds(), second.stamp.nanoseconds()), (1_000_000_001, 2_000_000_000));
            assert_eq!((first.pose.translation(), second.pose.translation()), (Point::new(1.0, 2.0), Point::new(3.0, 4.0)));
            assert!((first.pose.theta - 0.5).abs() < 1e-15 && (second.pose.theta + 0.5).abs() < 1e-15);
        }
    }

    #[test]
    fn errors_name_file_line_and_remedy() {
        for (text, expected) in [
            ("", "drive.tum has no data: expected lines of `timestamp x y z qx qy qz qw`"),
            ("# nothing\n\n", "drive.tum has no data: expected lines of `timestamp x y z qx qy qz qw`"),
            ("1 2 3\n", "drive.tum:1: 3 columns: expected `timestamp x y z qx qy qz qw` or `timestamp x y theta`"),
            ("#\n1 2 3 4\n2 2 nan 4\n", "drive.tum:3: y is `nan`: expected a finite number (fix or remove the line)"),
            ("1 2 3 inf", "drive.tum:1: theta is `inf`: expected a finite number (fix or remove the line)"),
            ("1 2 3 4,5", "drive.tum:1: theta is `4,5`: expected a finite number (fix or remove the line)"),
            ("nan 2 3 4", "drive.tum:1: the stamp is `nan`: expected seconds such as 1795374577.083470347"),
            ("1e300 2 3 4", "drive.tum:1: the stamp is `1e300`: expected seconds such as 1795374577.083470347"),
            (
                "1 0 0 0 1 0 0 1",
                "drive.tum:1: the quaternion's norm is 1.414: expected 1 (are the columns `timestamp x y z qx qy qz qw`?)",
            ),
            ("1 0 0 0 0 0 0 1\n2 0 0 0\n", "drive.tum:2: 4 columns, but 8 in the lines before (truncated? remove the line)"),
        ] {
            assert_eq!(tum_error(text), expected);
        }
    }

    #[test]
    fn errors_in_relations_name_file_line_and_remedy() {
        for (text, expected) in [
            ("# none\n", "lab.relations has no data: expected lines of `t1 t2 x y z roll pitch yaw`"),
            ("1 2 3 4 5\n", "lab.relations:1: 5 columns: expected `t1 t2 x y z roll pitch yaw`"),
            ("1 x 0 0 0 0 0 0", "lab.relations:1: the stamp is `x`: expected seconds such as 1795374577.083470347"),
            (
                "1 2 0 0 0 0 0 0\n1 2 0 0 0 0 0 NaN\n",
                "lab.relations:2: yaw is `NaN`: expected a finite number (fix or remove the line)",
            ),
        ] {
            assert_eq!(relations_error(text), expected);
        }
    }

    #[test]
    fn binary_files_are_not_trajectories() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("drive.bag");
        std::fs::write(&path, b"#ROSBAG V2.0\n\xff\xfe\n").unwrap();
        let message = tum::read(&path).unwrap_err().to_string();
        assert!(
            message.ends_with("drive.bag:2: this is not text (is it a bag?): expected lines of `timestamp x y z qx qy qz qw`"),
            "{message}"
        );
        assert!(tum::read(directory.path()).unwrap_err().to_string().starts_with("cannot read "));
    }

    proptest! {
        #[test]
        fn a_written_trajectory_is_read_back_unchanged(records in prop::collection::vec((-i64::MAX..i64::MAX, poses()), 1..50)) {
            let stamped = |&(ns, pose): &_| StampedPose { stamp: Stamp::from_nanoseconds(ns), pose };
            let trajectory = Trajectory::new(records.iter().map(stamped).collect()).unwrap();
            let read = tum::parse(&written(&trajectory), Path::new("")).unwrap();
            prop_assert_eq!(read.poses().len(), trajectory.poses().len());
            for (a, b) in read.poses().iter().zip(trajectory.poses()) {
                prop_assert_eq!(a.stamp, b.stamp);
                prop_assert!((a.pose.translation() - b.pose.translation()).norm() < 1e-9);
                prop_assert!(wrap_angle(a.pose.theta - b.pose.theta).abs() < 1e-11);
            }
        }

        #[test]
        fn a_truncated_file_is_read_or_rejected_at_its_last_line(cut in 0_usize..1000) {
            let whole = written(&drive(12));
            let lines = whole[..cut.min(whole.len())].lines().count();
            match tum::parse(&whole[..cut.min(whole.len())], Path::new("drive.tum")) {
                Ok(trajectory) => prop_assert_eq!(trajectory.poses().len(), lines),
                Err(_) if cut == 0 => {}
                Err(error) => {
                    let at_last_line = format!("drive.tum:{lines}: ");
                    prop_assert!(error.to_string().starts_with(&at_last_line), "{}", error);
                }
            }
        }

        #[test]
        fn no_text_makes_a_reader_panic(text in r"([-+0-9.eEnaif#,]{0,24}[ \t\n]{0,2}){0,40}", wild in any::<String>()) {
            for text in [text, wild] {
                drop(tum::parse(&text, Path::new("")));
                drop(relations::parse(&text, Path::new("")));
            }
        }

        #[test]
        fn finite_numbers_of_any_size_do_not_make_a_metric_panic(
            records in prop::collection::vec((any::<i64>(), any::<f64>(), any::<f64>(), any::<f64>()), 2..20)
        ) {
            let finite = records.iter().filter(|(_, x, y, theta)| x.is_finite() && y.is_finite() && theta.is_finite());
            let stamped = finite.map(|&(ns, x, y, theta)| StampedPose { stamp: Stamp::from_nanoseconds(ns), pose: Pose2::new(x, y, theta) });
            if let Ok(trajectory) = Trajectory::new(stamped.collect())
                && let Ok(matched) = associate(&trajectory, &trajectory, 0.1)
            {
                let _ = (ate(&matched), rpe(&matched, 1.0));
            }
        }
    }
}

/// The metric of Kuemmerle et al. on real logs: `corrected.txt` is the output of another SLAM system, the relations are ground truth.
mod real_relations {
    use super::*;

    fn load(log: &str) -> Option<RelationErrors> {
        let folder = shared(&format!("data/{log}"))?;
        let trajectory = tum::read(&folder.join("corrected.txt")).unwrap();
        let relations = relations::read(&folder.join(format!("{log}.relations"))).unwrap();
        relation_errors(&trajectory, &relations, 0.1)
    }

    fn assert_close(figure: f64, expected: f64, what: &str) {
        assert!((figure - expected).abs() <= 1e-9 * expected.abs(), "{what}: {figure}, expected {expected}");
    }

    /// Figures frozen from the reference script: count, mean, std and max of the translations (m), then of the rotations (deg).
    type Golden = (usize, [f64; 3], [f64; 3]);

    fn assert_golden(errors: &PoseErrors, (count, trans, rot): Golden, what: &str) {
        assert_eq!(errors.count, count, "{what}");
        for (s, golden) in [(errors.trans_m, trans), (errors.rot_deg, rot)] {
            for (figure, expected) in [s.mean, s.std, s.max].into_iter().zip(golden) {
                assert_close(figure, expected, what);
            }
        }
    }

    fn check(log: &str, beyond_max_dt: usize, all: Golden, short: Golden, long: Golden) {
        let Some(errors) = load(log) else { return };
        assert_eq!(errors.beyond_max_dt, beyond_max_dt, "{log}");
        assert_golden(&errors.all, all, log);
        assert_golden(&errors.short.unwrap(), short, log);
        assert_golden(&errors.long.unwrap(), long, log);
    }

    #[test]
    fn golden_figures_of_aces() {
        check(
            "aces",
            1275,
            (
                1279,
                [0.369_143_487_697_501_6, 0.231_927_507_190_390_85, 1.220_571_867_538_080_6],
                [5.571_618_397_023_626, 6.229_302_069_144_775, 39.361_627_567_692_41],
            ),
            (
                1178,
                [0.367_975_052_216_486_46, 0.228_319_983_295_293_43, 1.109_696_643_526_790_8],
                [5.232_335_143_713_36, 5.995_016_635_185_117, 39.361_627_567_692_41],
            ),
            (
                101,
                [0.382_771_378_753_301_9, 0.271_416_612_573_102_84, 1.220_571_867_538_080_6],
                [9.528_803_272_266_142, 7.465_209_362_255_001, 28.620_674_261_272_46],
            ),
        );
    }

    #[test]
    fn golden_figures_of_intel() {
        check(
            "intel",
            2810, // the script counts 2821: gaps of exactly 0.1 s become larger in its floating-point stamps
            (
                2984,
                [0.364_828_278_546_398_8, 0.212_845_978_022_790_98, 1.277_182_257_201_288_3],
                [4.611_267_253_431_43, 6.505_577_905_560_989, 40.632_218_774_174_55],
            ),
            (
                1770,
                [0.366_120_002_914_571_03, 0.202_959_337_103_224_72, 0.914_624_167_813_964_4],
                [4.638_321_045_227_686, 6.910_970_215_344_548, 40.632_218_774_174_55],
            ),
            (
                1214,
                [0.362_944_957_185_884_1, 0.226_561_258_310_195_5, 1.277_182_257_201_288_3],
                [4.571_823_092_410_53, 5.867_094_523_907_571, 37.705_206_581_969_215],
            ),
        );
    }

    #[test]
    fn golden_figures_of_fr079() {
        check(
            "fr079",
            11,
            (
                1685,
                [0.058_056_820_426_471_82, 0.041_855_104_901_671_29, 0.247_378_351_320_418_08],
                [0.711_982_429_643_919_9, 0.690_090_755_518_482, 5.903_453_042_036_581],
            ),
            (
                987,
                [0.040_785_800_865_927_98, 0.025_992_467_387_720_503, 0.166_059_205_485_707_68],
                [0.694_245_087_887_453_4, 0.665_637_206_089_773_3, 5.219_072_555_846_663],
            ),
            (
                698,
                [0.082_478_734_905_349_74, 0.047_509_672_562_111_6, 0.247_378_351_320_418_08],
                [0.737_063_742_414_167_1, 0.723_001_710_564_743_2, 5.903_453_042_036_581],
            ),
        );
    }

    #[test]
    fn the_dense_log_matches_its_published_figures() {
        // From the log's README.txt, which extrapolates the 11 stamps without a nearby pose by odometry: hence three digits, not nine.
        let Some(RelationErrors { all, .. }) = load("fr079") else { return };
        let figures = [all.trans_m.mean, all.trans_m.std, all.rot_deg.mean, all.rot_deg.std];
        for (figure, published) in figures.into_iter().zip([0.0581, 0.0419, 0.712, 0.691]) {
            assert!((figure / published - 1.0).abs() < 2e-3, "{figure} is not {published}");
        }
    }

    /// A Python with numpy, which the script needs.
    fn python() -> Option<String> {
        let named = std::env::var("PYTHON_WITH_NUMPY").ok();
        named
            .into_iter()
            .chain(["python3".to_owned(), "/usr/bin/python3".to_owned()])
            .find(|python| Command::new(python).args(["-c", "import numpy"]).output().is_ok_and(|output| output.status.success()))
    }

    #[test]
    fn the_reference_script_agrees_to_nine_digits() {
        let Some(python) = python() else {
            skip("no python3 with numpy (name one in PYTHON_WITH_NUMPY)");
            return;
        };
        for log in ["aces", "intel", "fr079"] {
            let Some(errors) = load(log) else { continue };
            let (Some(folder), Some(program)) = (shared(&format!("data/{log}")), shared("tools/relations_eval.py")) else {
                return;
            };
            let script = |limits: &[&str]| -> Value {
                let output = Command::new(&python)
                    .arg(&program)
                    .args([folder.join("corrected.txt"), folder.join(format!("{log}.relations"))])
                    .args(limits)
                    .arg("--json")
                    .output()
                    .unwrap();
                serde_json::from_slice(&output.stdout).expect("the script prints one JSON object")
            };
            let all = script(&[]);
            // Its floating-point stamps make some gaps of exactly 0.1 s larger than that.
            assert!(all["stamps_beyond_max_dt"].as_u64().unwrap() >= errors.beyond_max_dt as u64, "{log}");
            for (ours, theirs) in [
                (Some(errors.all), all),
                (errors.short, script(&["--max-rel-dt", "10"])),
                (errors.long, script(&["--min-dt", "10"])),
            ] {
                let ours = ours.unwrap();
                assert_eq!(theirs["used"], ours.count, "{log}");
                for (name, s) in [("trans_m", ours.trans_m), ("rot_deg", ours.rot_deg)] {
                    for (figure, key) in [(s.mean, "mean"), (s.std, "std"), (s.max, "max"), (s.median, "median"), (s.rmse, "rms")]
                    {
                        assert_close(figure, theirs[name][key].as_f64().unwrap(), &format!("{log} {name} {key}"));
                    }
                }
            }
        }
    }
}

mod program {
    use super::*;

    fn evaluate(arguments: &[&str]) -> Output {
        anytime(&[&["evaluate"], arguments].concat())
    }

    fn save(directory: &Path, name: &str, trajectory: &Trajectory) -> String {
        let path = directory.join(name);
        let mut writer = tum::TumWriter::new(std::fs::File::create(&path).unwrap());
        trajectory.poses().iter().for_each(|p| writer.write(p).unwrap());
        path.to_str().unwrap().to_owned()
    }

    /// The truth stretched by 1 % and moved: 1 cm of drift per metre of lane.
    fn stretched(truth: &Trajectory) -> Trajectory {
        let elsewhere = Pose2::new(5.0, -3.0, 2.0);
        mapped(truth, |p| StampedPose { pose: elsewhere * Pose2::new(1.01 * p.pose.x, 1.01 * p.pose.y, p.pose.theta), ..*p })
    }

    #[test]
    fn prints_a_table_or_one_object_and_draws() {
        let directory = tempfile::tempdir().unwrap();
        let truth = drive(400);
        let truth_path = save(directory.path(), "truth.tum", &truth);
        let estimate_path = save(directory.path(), "estimate.tum", &stretched(&truth));
        let relations_path = directory.path().join("x.relations").to_str().unwrap().to_owned();
        std::fs::write(&relations_path, "1795374577.083470347 1795374577.583470347 1 0 0 0 0 0\n").unwrap();
        let plot_path = directory.path().join("plot.svg").to_str().unwrap().to_owned();

        let output =
            evaluate(&[&estimate_path, "--truth", &truth_path, "--relations", &relations_path, "--json", "--plot", &plot_path]);
        assert!(output.status.success(), "{output:?}");
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!((json["rpe_1m_rmse_m"].as_f64().unwrap() - 0.0104).abs() < 5e-4, "{json}");
        assert!(json["rpe_1m_rmse_deg"].as_f64().unwrap() < 1e-6, "{json}");
        assert!((0.01..0.1).contains(&json["ate_rmse_m"].as_f64().unwrap()), "{json}");
        assert_eq!((&json["matched"], &json["relations"]["relations"]), (&400.into(), &1.into()));
        assert!(std::fs::read_to_string(&plot_path).unwrap().ends_with("</svg>\n"));

        let output = evaluate(&[&estimate_path, "--truth", &truth_path, "--rpe-distance", "0.5"]);
        let table = String::from_utf8(output.stdout).unwrap();
        assert!(table.contains("ATE") && table.contains("RPE per 0.5 m") && !table.contains("relations"), "{table}");
    }

    #[test]
    fn figures_without_their_truth_are_null_and_keys_name_the_distance() {
        let directory = tempfile::tempdir().unwrap();
        let path = save(directory.path(), "truth.tum", &drive(10));
        let relations = directory.path().join("x.relations");
        std::fs::write(&relations, "1 2 1 0 0 0 0 0\n").unwrap();
        let output = evaluate(&[&path, "--relations", relations.to_str().unwrap(), "--rpe-distance", "2.5", "--json"]);
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&json["ate_rmse_m"], &json["rpe_2.5m_rmse_m"]), (&Value::Null, &Value::Null));
        assert_eq!(json["relations"]["stamps_beyond_max_dt"], 1);
        assert_eq!(json["warnings"][0], "1 of 1 relations are more than 0.1 s from any pose: the nearest was used");
    }

    #[test]
    fn exit_codes_distinguish_usage_errors_from_failures() {
        let directory = tempfile::tempdir().unwrap();
        let path = save(directory.path(), "truth.tum", &drive(10));
        for usage_error in [
            &[path.as_str()][..],
            &["--truth", &path],
            &[&path, "--truth", &path, "--rpe-distance", "0"],
            &[&path, "--truth", &path, "--max-dt", "nan"],
        ] {
            assert_eq!(evaluate(usage_error).status.code(), Some(2), "{usage_error:?}");
        }
        let output = evaluate(&[&path, "--truth", "no-such.tum"]);
        assert_eq!(output.status.code(), Some(1));
        assert!(String::from_utf8(output.stderr).unwrap().starts_with("anytime: cannot read no-such.tum: "));
    }

    #[test]
    fn odd_trajectories_are_plotted_or_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("plot.svg");
        let still = mapped(&drive(5), |p| StampedPose { pose: Pose2::IDENTITY, ..*p });
        trajectory_plot(&path, &still, Some(&still), Some(&[]), 0.1).unwrap();
        trajectory_plot(&path, &drive(1), None, Some(&[Point::new(1.0, 1.0)]), 0.1).unwrap();
        assert!(trajectory_plot(&path, &still, Some(&drive(1)), None, 0.1).is_err());
        let diverged =
            mapped(&drive(3), |p| StampedPose { pose: Pose2::new(1e308 * (p.pose.x - 0.05), p.pose.y * 1e308, 0.0), ..*p });
        for truth in [None, Some(&diverged), Some(&drive(3))] {
            let _ = trajectory_plot(&path, &diverged, truth, None, 0.1);
        }
        let missing = trajectory_plot(&directory.path().join("no/such.svg"), &still, None, None, 0.1).unwrap_err();
        assert!(missing.to_string().starts_with("cannot write "), "{missing}");
    }
}
