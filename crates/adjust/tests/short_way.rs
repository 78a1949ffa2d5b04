//! The solver's short way for terms with a composite pose against the plain one, for chains of several kinds.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::Arc;

use boresight_adjust::{Chain, Layouts, Link, Reprojection, TargetPoints};
use boresight_camera::Model;
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{
    BlockId, Elimination, GramMut, Parameters, Problem, Scratch, SolveOptions, Term, Values, covariance,
    solve,
};

/// A term that the solver takes for a plain one.
struct Plain<'a>(&'a Reprojection);

impl Term for Plain<'_> {
    fn blocks(&self) -> &[BlockId] {
        self.0.blocks()
    }

    fn row_count(&self) -> usize {
        self.0.row_count()
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, scratch: &mut Scratch) -> Option<f64> {
        self.0.linearize(values, gram, scratch)
    }
}

/// Where the frame's pose, which is eliminated first, stands in the chain.
#[derive(Clone, Copy, Debug)]
enum FrameAt {
    /// `cam * frame`.
    End,
    /// `cam * frame * target`.
    Middle,
    /// `frame⁻¹ * cam * target`.
    InvertedStart,
    /// `cam * target`, and no frame.
    Nowhere,
}

fn pose(turn: [f64; 3], shift: [f64; 3]) -> Pose {
    Pose::from_rodrigues(Vector3::from(turn), Vector3::from(shift))
}

#[track_caller]
fn check(frame_at: FrameAt, held: &[(usize, usize)]) {
    let model: Model = "opencv5".parse().unwrap();
    let target = Target {
        name: "board".to_owned(),
        geometry: Geometry::Chessboard { columns: 7, rows: 5, spacing_m: 0.1 },
        shape: Shape::Parabolic2,
    };
    let observation = |idx: u32, wave: f64| Observation {
        point: PointId(idx),
        pixel: [
            500.0 + 40.0 * f64::from(idx % 7) + wave.sin(),
            400.0 + 41.0 * f64::from(idx / 7) + wave.cos(),
        ],
        sigma_px: 0.5,
    };
    let mut parameters = Parameters::default();
    let shape = parameters.add_vector(&[1e-3, -2e-3]);
    let cameras: Vec<(BlockId, BlockId)> = (0..3)
        .map(|camera| {
            let x = f64::from(camera);
            let lens = parameters.add_vector(&[
                900.0 + x,
                905.0,
                640.0,
                480.0 - x,
                -0.1,
                0.02 * x,
                1e-3,
                -1e-3,
                0.01,
            ]);
            let to_rig = pose([0.01 * x, -0.02, 0.03], [0.05 * x, 0.01, 0.02]);
            (lens, parameters.add_pose(&to_rig, Elimination::Reduced))
        })
        .collect();
    let to_first = parameters.add_pose(&pose([0.02, 0.01, -0.01], [0.01, 0.0, 0.02]), Elimination::Reduced);
    let mut views = Vec::new();
    for frame in 0..5 {
        let at = f64::from(frame);
        let rig_from_target = pose([0.3 - 0.1 * at, 0.1 * at - 0.2, 0.05 * at], [-0.3, -0.2, 0.8 + 0.1 * at]);
        let frame_pose = match frame_at {
            FrameAt::InvertedStart => pose([0.02 * at, 0.01, 0.0], [0.01, 0.02 * at, -0.7]),
            _ => rig_from_target,
        };
        let block = parameters.add_pose(&frame_pose, Elimination::First);
        for (camera, &(lens, to_rig)) in cameras.iter().enumerate() {
            // Not every camera sees every frame.
            if (frame as usize + camera) % 4 == 3 {
                continue;
            }
            let links = match frame_at {
                FrameAt::End => vec![Link::Block(to_rig), Link::Block(block)],
                FrameAt::Middle => vec![Link::Block(to_rig), Link::Block(block), Link::Block(to_first)],
                FrameAt::InvertedStart => {
                    vec![Link::Inverse(block), Link::Block(to_rig), Link::Block(to_first)]
                }
                FrameAt::Nowhere => {
                    vec![Link::Block(to_rig), Link::Known(rig_from_target), Link::Block(to_first)]
                }
            };
            views.push((lens, links, f64::from(frame * 3) + camera as f64));
        }
    }
    let layouts = Layouts::default();
    let terms: Vec<Reprojection> = views
        .into_iter()
        .map(|(lens, links, phase)| {
            let observations: Vec<Observation> =
                (0..35).map(|idx| observation(idx, phase + f64::from(idx))).collect();
            let points = Arc::new(TargetPoints::new(&target, &observations));
            let shape = Some((shape, 2));
            Reprojection::new(model, lens, shape, Chain { links }, points, &observations, &layouts)
        })
        .collect();
    // The gauge, and what the case holds beside it.
    parameters.hold_all(cameras[0].1);
    parameters.hold_all(to_first);
    held.iter().for_each(|&(camera, column)| parameters.hold(cameras[camera].0, column));
    let plain: Vec<Plain<'_>> = terms.iter().map(Plain).collect();
    let short = Problem::new(&parameters, terms.iter().map(|term| term as &dyn Term).collect()).unwrap();
    let plain = Problem::new(&parameters, plain.iter().map(|term| term as &dyn Term).collect()).unwrap();
    for max_iterations in [1, 3] {
        let options = SolveOptions { max_iterations, threads: 1, ..SolveOptions::default() };
        let (short, plain) = (solve(&short, &options).unwrap(), solve(&plain, &options).unwrap());
        // Sums in another order differ by rounding, and steps by that times the condition of the system;
        // a wrong map differs in the second digit.
        let (found, expected) = (short.cost, plain.cost);
        assert!((found - expected).abs() <= 1e-6 * expected, "{frame_at:?}: {found} {expected}");
        for (short, plain) in short.values.iter().zip(&plain.values) {
            assert!((short - plain).abs() <= 1e-5 * (1.0 + plain.abs()), "{frame_at:?}: {short} {plain}");
        }
    }
    let start: Vec<f64> = parameters.values().as_slice().to_vec();
    let options = SolveOptions::default();
    match (covariance(&short, &start, &options), covariance(&plain, &start, &options)) {
        (Ok(short), Ok(plain)) => {
            for &(lens, _) in &cameras {
                let (short, plain) =
                    (short.between((lens, 2), (lens, 2)), plain.between((lens, 2), (lens, 2)));
                assert!((short - plain).abs() <= 1e-7 * plain, "{frame_at:?}: {short} {plain}");
            }
        }
        (short, plain) => assert_eq!(short.is_ok(), plain.is_ok(), "{frame_at:?}"),
    }
}

#[test]
fn the_frame_at_the_end() {
    check(FrameAt::End, &[]);
}

#[test]
fn the_frame_between_others() {
    check(FrameAt::Middle, &[]);
}

#[test]
fn the_frame_inverted_and_first() {
    check(FrameAt::InvertedStart, &[]);
}

#[test]
fn no_frame_at_all() {
    check(FrameAt::Nowhere, &[]);
}

#[test]
fn held_columns_within_a_block() {
    check(FrameAt::End, &[(0, 8), (1, 0), (1, 5), (2, 2)]);
    check(FrameAt::Middle, &[(0, 8), (1, 0), (2, 4)]);
}
