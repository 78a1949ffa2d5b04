//! Times the residual block of one view: chain, rows and sums of products, for each closed-form lens.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "criterion's macros make the functions; a bench may panic"
)]

use std::hint::black_box;
use std::sync::Arc;

use boresight_adjust::{Chain, Layouts, Link, Reprojection, TargetPoints};
use boresight_camera::Model;
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{CompositeTerm, Elimination, Parameters, Scratch};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const N_POINTS: u32 = 100;

fn view(criterion: &mut Criterion) {
    let target = Target {
        name: "board".to_owned(),
        geometry: Geometry::Chessboard { columns: 10, rows: 10, spacing_m: 0.1 },
        shape: Shape::Parabolic2,
    };
    let observation = |i| Observation { point: PointId(i), pixel: [2000.0, 1000.0], sigma_px: 1.0 };
    let observations: Vec<Observation> = (0..N_POINTS).map(observation).collect();
    let points = Arc::new(TargetPoints::new(&target, &observations));
    let cam_from_rig = Pose::from_rodrigues(Vector3::new(0.01, 0.02, 0.03), Vector3::new(0.1, 0.0, 0.0));
    let rig_from_target = Pose::from_rodrigues(Vector3::new(0.2, -0.1, 0.05), Vector3::new(-0.4, -0.4, 2.0));
    let mut group = criterion.benchmark_group("corners of a view");
    group.throughput(Throughput::Elements(u64::from(N_POINTS)));
    for name in ["pinhole", "opencv5", "opencv8", "opencv14", "kannala-brandt4"] {
        let model: Model = name.parse().unwrap();
        let mut parameters = Parameters::default();
        let lens = parameters.add_vector(&model.undistorted([1700.0, 1701.0, 1999.5, 1099.5]));
        let links = vec![
            Link::Block(parameters.add_pose(&cam_from_rig, Elimination::Reduced)),
            Link::Block(parameters.add_pose(&rig_from_target, Elimination::First)),
        ];
        let shape = parameters.add_vector(&[1e-3, -1e-3]);
        let (chain, layouts) = (Chain { links }, &Layouts::default());
        let term =
            Reprojection::new(model, lens, Some((shape, 2)), chain, points.clone(), &observations, layouts);
        let mut scratch = Scratch::default();
        group.bench_function(name, |bencher| {
            bencher.iter(|| black_box(term.sum_products(parameters.values(), &mut scratch)).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, view);
criterion_main!(benches);
