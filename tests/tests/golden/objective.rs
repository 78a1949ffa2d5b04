//! The objective of mrcal 2.2's own test cases, `optimizer_callback_case*_v2.2.npz`: every residual and every
//! derivative, of boards, discrete points and moving cameras.
//!
//! A discrete point is a target of one point whose rotation is held; a camera that moves is a pose for each
//! place over one lens. Derivatives are read off a term by letting one row of its residuals be one.

use std::sync::Arc;

use boresight_adjust::{Chain, Layouts, Link, Reprojection, TargetPoints};
use boresight_camera::Model;
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use boresight_solver::{BlockId, Elimination, GramMut, Parameters, Scratch, Term};
use boresight_tests::conformance::conformance_file;
use boresight_tests::npz::Npz;

const LIMIT: f64 = 1e-9;
const N_LENS: usize = 12;

/// What a block is, and the column of mrcal's state at which it begins, where it is estimated.
struct Known {
    block: BlockId,
    column: Option<usize>,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// The core and the distortion are chosen apart.
    Lens {
        core: bool,
        distortion: bool,
    },
    Pose,
    Point,
    Shape,
}

/// The blocks of a case, in the order of mrcal's state.
struct State {
    parameters: Parameters,
    lenses: Vec<Known>,
    cameras: Vec<Known>,
    frames: Vec<Known>,
    points: Vec<Known>,
    shape: Known,
    n_columns: usize,
}

fn state(golden: &Npz) -> State {
    let [core, distortion, placement, frames, warp, _] =
        [0, 1, 2, 3, 4, 5].map(|i| golden.numbers("do_optimize")[i] != 0.0);
    let mut parameters = Parameters::default();
    let mut next = 0;
    let mut take = |count: usize| {
        next += count;
        (count > 0).then_some(next - count)
    };
    let n_of_lens = if core { 4 } else { 0 } + if distortion { N_LENS - 4 } else { 0 };
    let lenses = golden.numbers("intrinsics").chunks_exact(N_LENS).map(|lens| Known {
        block: parameters.add_vector(lens),
        column: take(n_of_lens),
        kind: Kind::Lens { core, distortion },
    });
    let lenses = lenses.collect();
    let mut poses = |name: &str, is_free: bool, kind: Kind, take: &mut dyn FnMut(usize) -> Option<usize>| {
        let size = if kind == Kind::Point { 3 } else { 6 };
        let poses = golden.numbers(name).chunks_exact(size).map(|numbers| {
            let pose = match kind {
                Kind::Point => Pose::from_rodrigues(Vector3::zeros(), Vector3::from_column_slice(numbers)),
                _ => pose(numbers),
            };
            let block = parameters.add_pose(&pose, Elimination::Reduced);
            Known { block, column: take(if is_free { size } else { 0 }), kind }
        });
        poses.collect::<Vec<Known>>()
    };
    let cameras = poses("rt_cam_ref", placement, Kind::Pose, &mut take);
    let boards = poses("rt_ref_frame", frames, Kind::Pose, &mut take);
    let points = poses("points", frames, Kind::Point, &mut take);
    let shape = Known {
        block: parameters.add_vector(golden.numbers("calobject_warp")),
        column: take(if warp { 2 } else { 0 }),
        kind: Kind::Shape,
    };
    State { parameters, lenses, cameras, frames: boards, points, shape, n_columns: next }
}

fn pose(rt: &[f64]) -> Pose {
    Pose::from_rodrigues(Vector3::new(rt[0], rt[1], rt[2]), Vector3::new(rt[3], rt[4], rt[5]))
}

/// One corner or point as a term, and the blocks it sees.
struct Row<'a> {
    term: Reprojection,
    observation: Observation,
    blocks: Vec<&'a Known>,
}

/// Returns the observation of `point` of `target` by camera (lens, place) `index`, where `place` -1 is the reference.
fn row<'a>(
    state: &'a State,
    index: [i32; 2],
    end: &'a Known,
    target: &Target,
    observation: Observation,
    layouts: &mut Layouts,
) -> Row<'a> {
    let lens = &state.lenses[index[0] as usize];
    let camera = usize::try_from(index[1]).ok().map(|camera| &state.cameras[camera]);
    let links = camera.into_iter().chain([end]).map(|known| Link::Block(known.block));
    let shape = (target.shape == Shape::Parabolic2).then_some(&state.shape);
    let points = Arc::new(TargetPoints::new(target, &[observation]));
    let model: Model = "opencv8".parse().unwrap();
    let chain = Chain { links: links.collect() };
    let with_shape = shape.map(|known| (known.block, 2));
    let term = Reprojection::new(model, lens.block, with_shape, chain, points, &[observation], layouts);
    let blocks = [lens].into_iter().chain(shape).chain(camera).chain([end]).collect();
    Row { term, observation, blocks }
}

/// Returns both residuals and both rows of derivatives by mrcal's state.
fn evaluate(state: &State, row: &Row<'_>, weight: f64) -> ([f64; 2], [Vec<f64>; 2]) {
    let values = state.parameters.values();
    let predicted = row.term.predict(values)[0].unwrap();
    let residuals = [0, 1].map(|axis| weight * (predicted[axis] - row.observation.pixel[axis]));
    let rows = [0, 1].map(|axis| {
        // With a residual of one in this row alone, the gradient is this row of J.
        let mut pixel = predicted;
        pixel[axis] -= 1.0;
        let unit = Observation { pixel, sigma_px: 1.0, ..row.observation };
        let gradient = gradient(row, &unit, state);
        let mut derivatives = vec![0.0; state.n_columns];
        let mut first = 0;
        for known in &row.blocks {
            let (n, columns) = match known.kind {
                Kind::Lens { core, distortion } => {
                    let all = &gradient[first..first + N_LENS];
                    let start = if core { 0 } else { 4 };
                    let end = if distortion { N_LENS } else { 4 };
                    (N_LENS, if start < end { all[start..end].to_vec() } else { Vec::new() })
                }
                Kind::Shape => (2, gradient[first..first + 2].to_vec()),
                Kind::Point => (6, gradient[first + 3..first + 6].to_vec()),
                Kind::Pose => {
                    let by_rodrigues = values.pose(known.block).tangent_by_rodrigues();
                    let by_tangent = &gradient[first..first + 6];
                    let column = |k: usize| (0..6).map(|i| by_tangent[i] * by_rodrigues[(i, k)]).sum();
                    (6, (0..6).map(column).collect())
                }
            };
            first += n;
            if let Some(start) = known.column {
                for (place, value) in derivatives[start..].iter_mut().zip(columns) {
                    *place = weight * value;
                }
            }
        }
        derivatives
    });
    (residuals, rows)
}

/// Returns the gradient of the row's term if it had seen `observation`.
fn gradient(row: &Row<'_>, observation: &Observation, state: &State) -> Vec<f64> {
    let term = row.term.with_pixels(&[*observation]);
    let n = 6 * row.blocks.iter().filter(|b| matches!(b.kind, Kind::Pose | Kind::Point)).count()
        + row
            .blocks
            .iter()
            .map(|b| match b.kind {
                Kind::Lens { .. } => N_LENS,
                Kind::Shape => 2,
                _ => 0,
            })
            .sum::<usize>();
    let side = n + 1;
    let mut entries = vec![0.0; side * side];
    let mut gram = GramMut::new(&mut entries, side);
    term.linearize(state.parameters.values(), &mut gram, &mut Scratch::default()).unwrap();
    (0..n).map(|a| entries[a * side + n]).collect()
}

/// Returns the largest error of residuals and of derivatives, each relative to the largest of its row.
fn check(case: usize) -> Option<[f64; 2]> {
    let path = conformance_file(&format!("mrcal/golden/optimizer_callback_case{case}_v2.2.npz"))?;
    let golden = Npz::read(&path).unwrap();
    let state = state(&golden);
    let x = golden.numbers("x_ref");
    let jacobian = golden.numbers("J_ref_unpacked");
    assert_eq!(golden.shape("J_ref_unpacked"), [x.len(), state.n_columns], "case {case}");
    let mut layouts = Layouts::default();
    let mut worst = [0.0_f64; 2];
    let mut next = 0;
    let mut compare = |residual: f64, row: &[f64]| {
        let expected = &jacobian[next * state.n_columns..(next + 1) * state.n_columns];
        let scale = expected.iter().fold(0.0, |largest: f64, x| largest.max(x.abs())).max(f64::MIN_POSITIVE);
        worst[0] = worst[0].max((residual - x[next]).abs() / x[next].abs().max(1.0));
        let error = row.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        worst[1] = worst[1].max(error / scale);
        next += 1;
    };
    let [columns, rows] = [2, 1].map(|axis| golden.shape("observations_board")[axis] as u32);
    let geometry = Geometry::Chessboard { columns, rows, spacing_m: golden.number("spacing") };
    let board = Target { name: "board".to_owned(), geometry, shape: Shape::Parabolic2 };
    let corners = golden.numbers("observations_board").chunks_exact(3 * (columns * rows) as usize);
    for (index, corners) in golden.numbers("indices_board").chunks_exact(3).zip(corners) {
        for (point, corner) in corners.chunks_exact(3).enumerate() {
            if corner[2] < 0.0 {
                // An outlier: rows of zeros.
                let zeros = vec![0.0; state.n_columns];
                compare(0.0, &zeros);
                compare(0.0, &zeros);
                continue;
            }
            let observation =
                Observation { point: PointId(point as u32), pixel: [corner[0], corner[1]], sigma_px: 1.0 };
            let end = &state.frames[index[0] as usize];
            let row = row(&state, [index[1] as i32, index[2] as i32], end, &board, observation, &mut layouts);
            let (residuals, rows) = evaluate(&state, &row, corner[2]);
            (0..2).for_each(|axis| compare(residuals[axis], &rows[axis]));
        }
    }
    let point = Target {
        name: "point".to_owned(),
        geometry: Geometry::Points { points_m: vec![[0.0; 3]] },
        shape: Shape::Rigid,
    };
    let seen = golden.numbers("observations_point").chunks_exact(3);
    for (index, seen) in golden.numbers("indices_point").chunks_exact(3).zip(seen) {
        let observation = Observation { point: PointId(0), pixel: [seen[0], seen[1]], sigma_px: 1.0 };
        let end = &state.points[index[0] as usize];
        let row = row(&state, [index[1] as i32, index[2] as i32], end, &point, observation, &mut layouts);
        let (residuals, rows) = evaluate(&state, &row, seen[2]);
        (0..2).for_each(|axis| compare(residuals[axis], &rows[axis]));
        // mrcal 2.2's penalty of points out of a range, which all of these are in.
        compare(0.0, &vec![0.0; state.n_columns]);
    }
    for (row, regularization) in regularization(&golden, &state) {
        compare(regularization, &row);
    }
    assert_eq!(next, x.len(), "case {case}");
    Some(worst)
}

/// Returns mrcal 2.2's rows of regularisation: its formula, and each row's single derivative.
fn regularization(golden: &Npz, state: &State) -> Vec<(Vec<f64>, f64)> {
    if golden.numbers("do_optimize")[5] == 0.0 {
        return Vec::new();
    }
    // Two rows for each corner, three for each observation of a point.
    let n_rows =
        golden.numbers("observations_board").len() / 3 * 2 + golden.numbers("observations_point").len();
    let n_cameras = state.lenses.len();
    let (mut distortions, mut centres) = (Vec::new(), Vec::new());
    for (lens, known) in golden.numbers("intrinsics").chunks_exact(N_LENS).zip(&state.lenses) {
        let Kind::Lens { core, distortion } = known.kind else { continue };
        let Some(start) = known.column else { continue };
        let size = [0, 1].map(|axis| golden.numbers("imagersizes")[axis] as u32);
        for (column, mean, inverse_sigma) in
            boresight_adjust::mrcal22_rows(n_rows, n_cameras, N_LENS, true, size)
        {
            let is_centre = column < 4;
            let mut row = vec![0.0; state.n_columns];
            let place = if is_centre { column } else { column - if core { 0 } else { 4 } };
            if (is_centre && !core) || (!is_centre && !distortion) {
                continue;
            }
            row[start + place] = inverse_sigma;
            let entry = (row, (lens[column] - mean) * inverse_sigma);
            if is_centre { centres.push(entry) } else { distortions.push(entry) }
        }
    }
    distortions.extend(centres);
    distortions
}

#[test]
fn objective_and_derivatives_match_mrcal() {
    for case in 0..6 {
        let Some([residual, derivative]) = check(case) else { return };
        println!("case {case}: residuals {residual:.1e}, derivatives {derivative:.1e}");
        assert!(residual <= LIMIT, "case {case}: {residual:e}");
        assert!(derivative <= LIMIT, "case {case}: {derivative:e}");
    }
}
