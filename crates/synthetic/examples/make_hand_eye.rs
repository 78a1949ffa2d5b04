//! Writes a synthetic hand-eye recording with its truth: `make_hand_eye on-flange|fixed FOLDER`.
#![allow(clippy::print_stderr, reason = "an example talks to the developer who runs it")]

use std::fmt::Write as _;
use std::path::Path;

use boresight_data::Id as _;
use boresight_geometry::Pose;
use boresight_synthetic::{Recipe, RobotRecipe, add_robot, simulate};

fn main() -> std::io::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [mount, folder] = words.as_slice() else {
        eprintln!("usage: make_hand_eye on-flange|fixed FOLDER");
        std::process::exit(2);
    };
    let robot = if mount == "fixed" { RobotRecipe::fixed() } else { RobotRecipe::on_flange() };
    let robot = RobotRecipe { rotation_rad: 0.0004, translation_m: 0.0003, ..robot };
    let recipe = if mount == "fixed" { Recipe::mono() } else { Recipe::stereo() };
    let mut made = simulate(&Recipe { frames: 24, ..recipe }, 2026);
    add_robot(&mut made, &robot, 711);

    let mut corners = "camera,view,point,u,v\n".to_owned();
    for view in &made.dataset.views {
        let camera = &made.dataset.cameras[view.camera].name;
        let frame = &made.dataset.frames[view.frame].name;
        for observation in &view.observations {
            let [u, v] = observation.pixel;
            let _ = writeln!(corners, "{camera},{frame},{},{u:.4},{v:.4}", observation.point.index());
        }
    }
    // The fixed camera's robot writes as KUKA does, the other as ROS does.
    let header =
        if mount == "fixed" { "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg" } else { "x_m,y_m,z_m,qx,qy,qz,qw" };
    let mut poses = format!("frame,{header}\n");
    for frame in made.dataset.frames.iter() {
        let Some(pose) = frame.base_from_flange else { continue };
        let (t, q) = (pose.translation, pose.rotation.coords);
        let _ = if mount == "fixed" {
            let (c, b, a) = pose.rotation.euler_angles();
            let t = t * 1e3;
            let [a, b, c] = [a, b, c].map(f64::to_degrees);
            writeln!(poses, "{},{:.4},{:.4},{:.4},{a:.5},{b:.5},{c:.5}", frame.name, t.x, t.y, t.z)
        } else {
            let numbers = [t.x, t.y, t.z, q.x, q.y, q.z, q.w].map(|number| format!("{number:.8}"));
            writeln!(poses, "{},{}", frame.name, numbers.join(","))
        };
    }
    let pose = |pose: Pose| {
        format!(
            "{{ \"rodrigues\": {:?}, \"translation_m\": {:?} }}",
            pose.rodrigues().as_slice(),
            pose.translation.as_slice()
        )
    };
    let lenses: Vec<String> = recipe_lenses(&made).iter().map(|params| format!("{params:?}")).collect();
    let truth = format!(
        "{{\n  \"mount\": \"{mount}\",\n  \"carrier_from_rig\": {},\n  \"other_from_target\": {},\n  \"shape_m\": {:?},\n  \
         \"robot_rotation_rad\": {},\n  \"robot_translation_m\": {},\n  \"lenses\": [{}]\n}}\n",
        pose(robot.carrier_from_rig),
        pose(robot.other_from_target),
        Recipe::mono().shape_m,
        robot.rotation_rad,
        robot.translation_m,
        lenses.join(", ")
    );
    let folder = Path::new(folder);
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("corners.csv"), corners)?;
    std::fs::write(folder.join("poses.csv"), poses)?;
    std::fs::write(folder.join("truth.json"), truth)
}

fn recipe_lenses(made: &boresight_synthetic::Synthetic) -> Vec<Vec<f64>> {
    made.truth.rig.cameras.iter().flatten().map(|camera| camera.camera.params.clone()).collect()
}
