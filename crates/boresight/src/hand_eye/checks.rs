//! What a robot's motions can tell, checked before anything is solved; and the texts of all robot findings.

use boresight_data::{Finding, Severity};
use boresight_geometry::Pose;
use boresight_io::RobotAxes;
use boresight_seed::hand_eye::motion_spread;

use crate::error::Error;

/// Distinct poses below which nothing is determined, and below which little is.
const LEAST_POSES: usize = 3;
const FEW_POSES: usize = 8;
/// Rotations in degrees below which translations cannot be told from rotations, and below which they hardly can.
const LEAST_ROTATION_DEG: f64 = 2.0;
const LITTLE_ROTATION_DEG: f64 = 20.0;
/// How much a robot must turn about a second axis, relative to the first: a tilt of 1.7 degrees in 60, and of 9.
const LEAST_SECOND_AXIS: f64 = 0.03;
const LITTLE_SECOND_AXIS: f64 = 0.15;

/// Returns what is doubtful about a robot's poses, or the reason why nothing can come of them.
pub fn check_motions(base_from_flange: &[Pose], axes: RobotAxes) -> Result<Vec<Finding>, Error> {
    let spread = motion_spread(base_from_flange);
    let degrees = spread.largest_rotation_rad.to_degrees();
    let finding = |code: &str, severity, message: String, measured: f64, limit: f64, fix: String| Finding {
        code: code.to_owned(),
        severity,
        place: "robot".to_owned(),
        message,
        measured: Some(measured),
        limit: Some(limit),
        fix,
    };
    let refuse = |finding: Finding| Err(Error::Degenerate(Box::new(finding)));
    let distinct = spread.distinct as f64;
    if spread.distinct < LEAST_POSES {
        let message = format!(
            "{} of {} poses differ by more than 0.5 degrees or 1 mm; {LEAST_POSES} must",
            spread.distinct,
            base_from_flange.len()
        );
        let missing = LEAST_POSES - spread.distinct;
        let fix = format!(
            "Add {missing} poses at the least, 10 for a good result, each turned by 30 degrees or more about another axis."
        );
        return refuse(finding(
            "robot-few-poses",
            Severity::Fail,
            message,
            distinct,
            LEAST_POSES as f64,
            fix,
        ));
    }
    if degrees < LEAST_ROTATION_DEG {
        let message =
            format!("no two poses differ by more than {degrees:.2} degrees: the robot did not turn");
        let fix = "Add 4 poses turned by 30 degrees or more, two about the flange's x axis and two about its y axis; \
                   moves without turns tell the camera's orientation only.";
        return refuse(finding(
            "robot-no-rotation",
            Severity::Fail,
            message,
            degrees,
            LEAST_ROTATION_DEG,
            fix.to_owned(),
        ));
    }
    let mut findings = Vec::new();
    let second = spread.second_axis();
    let [x, y, z] = spread.axes[0];
    if axes == RobotAxes::Six {
        let message = format!(
            "the robot turned about one axis, ({x:.2}, {y:.2}, {z:.2}) of what bears the camera: about the second it \
             turned {second:.3} times as much; the translation along the first is open"
        );
        let [x, y, z] = spread.axes[1];
        let fix = format!(
            "Add 3 poses turned by 30 degrees or more about ({x:.2}, {y:.2}, {z:.2}) of what bears the camera; for a \
             robot that cannot, write axes = 4 and height_m in [robot]."
        );
        if second < LEAST_SECOND_AXIS {
            return refuse(finding(
                "robot-one-axis",
                Severity::Fail,
                message,
                second,
                LEAST_SECOND_AXIS,
                fix,
            ));
        }
        if second < LITTLE_SECOND_AXIS {
            let message = message.replace("is open", "is badly determined");
            findings.push(finding(
                "robot-one-axis",
                Severity::Caution,
                message,
                second,
                LITTLE_SECOND_AXIS,
                fix,
            ));
        }
    }
    if axes == RobotAxes::Four && second >= LITTLE_SECOND_AXIS {
        let message = format!(
            "the robot is said to have four axes, and turned about a second one {second:.2} times as much as about the first"
        );
        let fix = "Leave out axes and height_m in [robot]: turns about several axes tell the height. If it has four, its \
                   poses are misread: `boresight robot poses` tries all readings."
            .to_owned();
        let limit = LITTLE_SECOND_AXIS;
        findings.push(finding("robot-more-axes", Severity::Caution, message, second, limit, fix));
    }
    if spread.distinct < FEW_POSES {
        let message = format!("{} distinct poses leave little to check the result against", spread.distinct);
        let fix = format!("Add {} poses, turned about different axes.", FEW_POSES - spread.distinct);
        findings.push(finding(
            "robot-few-poses",
            Severity::Caution,
            message,
            distinct,
            FEW_POSES as f64,
            fix,
        ));
    }
    if degrees < LITTLE_ROTATION_DEG {
        let message = format!("the poses differ by {degrees:.1} degrees at most");
        let fix = "Add poses turned by 30 to 60 degrees about the flange's x and y axes: an error of the translation \
                   falls with the sine of the turn."
            .to_owned();
        findings.push(finding(
            "robot-no-rotation",
            Severity::Caution,
            message,
            degrees,
            LITTLE_ROTATION_DEG,
            fix,
        ));
    }
    Ok(findings)
}

/// The codes of findings about robots, with their long texts.
pub const ROBOT_CODES: &[(&str, &str)] = &[
    (
        "clock-not-steady",
        "What it means: the offset between the clocks of robot and camera is not the same in both halves of the recording.\n\n\
         Why it matters: one offset serves the whole recording; a clock that drifts, or times of arrival instead of\n\
         exposure, put the robot elsewhere than the camera saw it.\n\n\
         How to fix it: time both by one clock, or record for a shorter time; use the times of exposure.",
    ),
    (
        "clock-offset",
        "What it means: the clocks of robot and camera are apart. The offset was estimated together with the poses, and\n\
         the robot's poses were taken at the camera's times with it.\n\n\
         Why it matters: a robot that moves at a metre a second is off by a millimetre for each millisecond.\n\n\
         How to fix it: nothing, as long as the offset is used with the result wherever the robot moves.",
    ),
    (
        "clock-offset-unclear",
        "What it means: how fast the robot turned and how fast the target was seen to turn do not agree well at any offset\n\
         of the clocks, or agree as well at another.\n\n\
         Why it matters: with a wrong offset every pair of poses is wrong, and the calibration with it.\n\n\
         How to fix it: turn faster and about changing axes, with stops in between; check that both files are of one\n\
         recording, and that the tracker followed one target.",
    ),
    (
        "joint-unit",
        "What it means: the target turns by more or less than a joint's reading says.\n\n\
         Why it matters: with the wrong unit or gear ratio no line of a joint is where it is computed.\n\n\
         How to fix it: name the column with the unit the readings have, j1_deg or j1_rad, and check which is which.",
    ),
    (
        "robot-few-poses",
        "What it means: the robot was in fewer different poses than the calibration needs; poses that differ by less\n\
         than half a degree and a millimetre count once. Three are the least, eight leave something to check with.\n\n\
         Why it matters: two unknown poses of six numbers each are sought. Two motions about different axes determine\n\
         them; with no more than these every error of a pose goes into the result unseen.\n\n\
         How to fix it: add poses in which the flange is turned by 30 to 60 degrees about different axes, with the\n\
         target well in the image. Ten to twenty are usual.",
    ),
    (
        "robot-frame-off",
        "What it means: a frame is foretold far worse by all other frames than these are by each other.\n\n\
         Why it matters: the robot's pose of that frame may be wrong (recorded while moving, of another image, with\n\
         another tool), or its corners may be. One such frame bends the whole result.\n\n\
         How to fix it: look at the frame's image and pose; take the frame out, or record it again at rest.",
    ),
    (
        "robot-height-open",
        "What it means: a robot that turns about its vertical axis only cannot tell how high the camera, or the target,\n\
         is: raising both changes no picture. The height was not given and is taken as zero.\n\n\
         Why it matters: positions across the axis are right, heights are off by a constant.\n\n\
         How to fix it: touch points of the target with a tip that is known, and name them as touches with tip_mm in\n\
         [robot]; or measure the height above the base's origin, and write height_m.",
    ),
    (
        "robot-misfit",
        "What it means: frames left out are missed by more than 3 % of the target's distance, 30 mm at a metre; or the robot\n\
         turns by more than a degree otherwise than it says; or, of all readings of the poses, the best misses frames left\n\
         out by more than 5 % of the distance.\n\n\
         Why it matters: no robot is off by so much. The poses and the pictures do not belong together, and the calibration\n\
         is meaningless.\n\n\
         How to fix it: check that each row is of its own frame, that the poses are of one tool and of this recording, and\n\
         that clocks are matched where the robot moved; `boresight robot poses` tries all conventions.",
    ),
    (
        "robot-mounting",
        "What it means: the poses fit far better if the camera is taken to be where the job says it is not: on the\n\
         flange instead of fixed, or the other way round. Inverted poses (flange_from_base) look the same to the data.\n\n\
         Why it matters: the result is meaningless if the mount or the direction of the poses is wrong.\n\n\
         How to fix it: correct `mount` of [robot], or add :inverse to the convention of the poses;\n\
         `boresight robot poses` tries all readings.",
    ),
    (
        "robot-more-axes",
        "What it means: axes = 4 says that the robot turns about its vertical axis only, and its poses turn about others too.\n\n\
         Why it matters: of four axes the height is not asked for, although these poses would tell it. If the robot has four\n\
         after all, its poses are misread.\n\n\
         How to fix it: leave out axes and height_m in [robot]; or find the right reading of the poses with\n\
         `boresight robot poses`.",
    ),
    (
        "robot-no-rotation",
        "What it means: the robot hardly turned between poses.\n\n\
         Why it matters: motions without rotation tell the orientation of the camera on the flange and nothing of its\n\
         position. With small rotations the error of the position is that of a pose divided by the sine of the turn.\n\n\
         How to fix it: add poses turned by 30 to 60 degrees about at least two axes that are not parallel.",
    ),
    (
        "robot-noise-not-used",
        "What it means: the errors of the robot's poses were estimated, but frames that were left out are foretold\n\
         better without them; the answer takes the robot's word as exact, or keeps the lenses as found by themselves.\n\n\
         Why it matters: with few poses a noise model can take up errors that are none of the robot's. The sigmas then\n\
         come from the scatter of solutions without one frame each, not from the model.\n\n\
         How to fix it: nothing needs to be; more poses let the noise be told better.",
    ),
    (
        "robot-one-axis",
        "What it means: all turns of the robot were about nearly the same axis.\n\n\
         Why it matters: a translation of camera and target along that axis changes no picture, so it is open; so is\n\
         part of what depends on it. Methods that do not notice return numbers all the same.\n\n\
         How to fix it: add poses turned by 30 degrees or more about an axis square to the first, such as tilts about\n\
         the camera's x and y axes. For robots with four axes write axes = 4 and height_m in [robot].",
    ),
    (
        "robot-poses-read",
        "What it means: the table of poses fits the pictures far better if its numbers are read in another convention:\n\
         another unit, order of a quaternion, kind of Euler angles, direction, or mount.\n\n\
         Why it matters: with the wrong reading the calibration is meaningless, however small its residuals look.\n\n\
         How to fix it: check the convention that is named against the robot's manual, and state it as `convention` of\n\
         [robot] or with --poses-as. It is never changed without being told.",
    ),
    (
        "robot-stretched",
        "What it means: the robot's positions and the pictures agree far better if positions are corrected by a linear\n\
         map of the distance from their middle, `stretch` in the result. A common scale in it says that the target's\n\
         spacing is not what was stated, or that the robot's lengths are not; the rest are errors of its axes.\n\n\
         Why it matters: without the correction every position is off by that much for each metre of travel. With it,\n\
         the calibration holds for corrected positions only.\n\n\
         How to fix it: measure the target's spacing over its whole length. Have the robot calibrated, or correct the\n\
         positions it says by `stretch` of hand-eye.json before the result is used with them:\n\
         corrected = position + matrix * (position - centre), rotations as they are. Who cannot correct positions uses the\n\
         poses under `without_stretch`, which foretell worse by what the finding says.",
    ),
    (
        "robot-unpaired",
        "What it means: some frames in which corners were seen have no row in the table of the robot's poses, or some rows\n\
         name frames in which nothing was seen; or a robot that moved told no pose at the time of some frames.\n\n\
         Why it matters: such frames tell of the lenses and not of where cameras sit; such poses tell nothing. Where names are\n\
         misspelt, poses are lost.\n\n\
         How to fix it: compare the column `frame` with the names that `boresight info` lists; of a robot that moved, record\n\
         poses without gaps, for longer than images are taken.",
    ),
    (
        "sights-far-off",
        "What it means: more sights of the target are far from where robot and calibration put them than noise explains:\n\
         another target, a mirrored pose, a moment at which the tracker was lost.\n\n\
         Why it matters: they count for little, but cannot be told from sights that are merely bad.\n\n\
         How to fix it: look at these frames, use larger targets or ones seen more aslant, and leave out what is wrong.",
    ),
    (
        "touches-off",
        "What it means: the tip, where the robot says it was, is far from the points of the target that it touched.\n\n\
         Why it matters: touches join the adjustment with the weight of their stated sigma; a wrong tip, or touches of other\n\
         points, pull cameras and target away from where they are.\n\n\
         How to fix it: check tip_mm, or leave it out to have it estimated; check which points were touched, counted from 0\n\
         row by row, and the convention of the touches' poses.",
    ),
];

#[cfg(test)]
mod tests {
    use boresight_geometry::Vector3;

    use super::*;

    fn poses(n: usize, turn: impl Fn(f64) -> [f64; 3]) -> Vec<Pose> {
        (0..n)
            .map(|i| Pose::from_rodrigues(turn(i as f64).into(), Vector3::new(0.1 * i as f64, 0.0, 0.5)))
            .collect()
    }

    fn refused(poses: &[Pose], axes: RobotAxes) -> Option<String> {
        match check_motions(poses, axes) {
            Err(Error::Degenerate(finding)) => Some(finding.code),
            _ => None,
        }
    }

    #[test]
    fn degenerate_motions_get_the_right_code() {
        let turning = |i: f64| [0.5 * i.sin(), 0.6 * (2.0 * i).cos(), 0.3 * i.cos()];
        for (poses, code) in [
            (poses(10, |_| [0.1, 0.2, 0.3]), Some("robot-no-rotation")),
            (poses(10, |i| [0.0, 0.2 * i, 0.0]), Some("robot-one-axis")),
            (poses(2, turning), Some("robot-few-poses")),
            (vec![Pose::identity(); 10], Some("robot-few-poses")),
            (poses(10, turning), None),
        ] {
            assert_eq!(refused(&poses, RobotAxes::Six).as_deref(), code);
        }
        let more = check_motions(&poses(10, turning), RobotAxes::Four).unwrap();
        assert_eq!(more.iter().map(|finding| finding.code.as_str()).collect::<Vec<_>>(), ["robot-more-axes"]);
        assert!(check_motions(&poses(10, |i| [0.0, 0.0, 0.2 * i]), RobotAxes::Four).unwrap().is_empty());
        let few = check_motions(&poses(5, turning), RobotAxes::Six).unwrap();
        assert_eq!(few.iter().map(|finding| finding.code.as_str()).collect::<Vec<_>>(), ["robot-few-poses"]);
    }

    #[test]
    fn a_fix_names_the_axis_to_turn_about() {
        let Err(Error::Degenerate(finding)) =
            check_motions(&poses(9, |i| [0.0, 0.0, 0.3 * i]), RobotAxes::Six)
        else {
            panic!("one axis is refused");
        };
        assert!(finding.message.contains("0.00, 0.00, ") && finding.fix.contains("0.00)"), "{finding:?}");
    }
}
