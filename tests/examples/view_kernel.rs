//! Times the residual block of one view of a conformance problem, in nanoseconds per corner.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::sync::Arc;
use std::time::Instant;

use boresight_adjust::{Chain, Layouts, Link, Reprojection, TargetPoints};
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{Elimination, GramMut, Parameters, Scratch, Term};

fn main() {
    let target = Target {
        name: "board".to_owned(),
        geometry: Geometry::Chessboard { columns: 10, rows: 10, spacing_m: 0.1 },
        shape: Shape::Parabolic2,
    };
    let observations: Vec<Observation> =
        (0..100).map(|i| Observation { point: PointId(i), pixel: [2000.0, 1000.0], sigma_px: 1.0 }).collect();
    let points = Arc::new(TargetPoints::new(&target, &observations));
    let mut parameters = Parameters::default();
    let lens = [1700.0, 1701.0, 1999.5, 1099.5, -0.01, 0.05, 1e-4, 2e-4, 0.01, 0.3, 0.02, 0.01];
    let lens = parameters.add_vector(&lens);
    let cam_from_rig = Pose::from_rodrigues(Vector3::new(0.01, 0.02, 0.03), Vector3::new(0.1, 0.0, 0.0));
    let rig_from_target = Pose::from_rodrigues(Vector3::new(0.2, -0.1, 0.05), Vector3::new(-0.4, -0.4, 2.0));
    let links = vec![
        Link::Block(parameters.add_pose(&cam_from_rig, Elimination::Reduced)),
        Link::Block(parameters.add_pose(&rig_from_target, Elimination::First)),
    ];
    let shape = parameters.add_vector(&[1e-3, -1e-3]);
    let term = Reprojection::new(
        "opencv8".parse().unwrap(),
        lens,
        Some((shape, 2)),
        Chain { links },
        points,
        &observations,
        &mut Layouts::default(),
    );
    let mut entries = vec![0.0; 27 * 27];
    let mut scratch = Scratch::default();
    let mut best = f64::INFINITY;
    for _ in 0..400 {
        let start = Instant::now();
        for _ in 0..50 {
            let mut gram = GramMut::new(&mut entries, 27);
            std::hint::black_box(term.linearize(parameters.values(), &mut gram, &mut scratch)).unwrap();
        }
        best = best.min(start.elapsed().as_secs_f64() / 50.0);
    }
    println!("{:.2} ns per corner", best * 1e9 / 100.0);
}
