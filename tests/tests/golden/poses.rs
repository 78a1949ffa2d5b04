//! mrcal 2.2's pose algebra with its derivatives, `golden_poseutils.npz`.

use boresight_geometry::{Matrix6, Pose, Vector3, rotation_by_rodrigues, skew};
use boresight_tests::conformance::conformance_file;
use boresight_tests::npz::Npz;

/// Relative to the largest entry of what is compared.
const LIMIT: f64 = 1e-9;

/// Below this angle in radians mrcal 2.2's derivatives by a rotation vector are not exact: against 60 digits
/// (Python 3's decimal) those of its transform are off by up to 4e-5, ours by rounding.
const SMALL_ANGLE: f64 = 1e-5;

fn pose(rt: &[f64]) -> Pose {
    Pose::from_rodrigues(Vector3::new(rt[0], rt[1], rt[2]), Vector3::new(rt[3], rt[4], rt[5]))
}

/// Returns the largest difference relative to the largest number expected, one being the least scale.
fn relative(found: impl IntoIterator<Item = f64>, expected: &[f64]) -> f64 {
    let scale = expected.iter().fold(1.0, |largest: f64, x| largest.max(x.abs()));
    let pairs = found.into_iter().zip(expected);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale
}

/// Returns the entries row by row.
fn rows<const R: usize, const C: usize>(
    matrix: &boresight_geometry::nalgebra::SMatrix<f64, R, C>,
) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}

#[test]
fn poses_match_mrcal() {
    let Some(path) = conformance_file("mrcal/golden/golden_poseutils.npz") else { return };
    let golden = Npz::read(&path).unwrap();
    let n_poses = golden.shape("rt")[0];
    let entry = |name: &str, i: usize| {
        let numbers = golden.numbers(name);
        let size = numbers.len() / n_poses;
        &numbers[i * size..(i + 1) * size]
    };
    let mut largest: Vec<(&str, f64)> = Vec::new();
    let mut note = |name: &'static str, error: f64| match largest.iter_mut().find(|(known, _)| *known == name)
    {
        Some((_, known)) => *known = known.max(error),
        None => largest.push((name, error)),
    };
    for i in 0..n_poses {
        let (rt, rt2) = (entry("rt", i), entry("rt2", i));
        let (one, two) = (pose(rt), pose(rt2));
        let x = Vector3::from_column_slice(entry("x", i));
        let rotation_vector = Vector3::from_column_slice(&rt[..3]);
        note("R", relative(rows(&one.rotation_matrix()), entry("R", i)));
        let by_r = rotation_by_rodrigues(&rotation_vector);
        // (row, column, component of r).
        let dr = (0..9).flat_map(|rc| [0, 1, 2].map(|k| by_r[k][(rc / 3, rc % 3)]));
        let is_small = |rt: &[f64]| Vector3::from_column_slice(&rt[..3]).norm() < SMALL_ANGLE;
        if !is_small(rt) {
            note("dR_dr", relative(dr, entry("dR_dr", i)));
        }
        let moved = one * x;
        note("transform", relative(moved.iter().copied(), entry("transform", i)));
        // A left perturbation (w, v) moves the point by w × p + v.
        let mut by_tangent = boresight_geometry::nalgebra::Matrix3x6::zeros();
        by_tangent.fixed_view_mut::<3, 3>(0, 0).copy_from(&-skew(&moved));
        by_tangent.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        if !is_small(rt) {
            let by_rt = rows(&(by_tangent * one.tangent_by_rodrigues()));
            note("transform_drt", relative(by_rt, entry("transform_drt", i)));
        }
        note("transform_dx", relative(rows(&one.rotation_matrix()), entry("transform_dx", i)));

        // A rotation vector is unique up to full turns: compare at the one that mrcal returns.
        let both = one * two;
        let full_turns = |pose: &Pose, theirs: &[f64]| {
            let own = pose.rodrigues();
            let theirs = Vector3::from_column_slice(&theirs[..3]);
            if (own - theirs).norm() < 1e-6 { own } else { own - own.normalize() * std::f64::consts::TAU }
        };
        let composed = entry("compose_rt", i);
        let r = full_turns(&both, composed);
        note("compose_rt", relative(r.iter().chain(both.translation.iter()).copied(), composed));
        if r.norm() <= std::f64::consts::PI && !is_small(rt) && !is_small(rt2) {
            let d0: Matrix6<f64> = both.rodrigues_by_tangent() * one.tangent_by_rodrigues();
            let d1 = both.rodrigues_by_tangent() * one.adjoint() * two.tangent_by_rodrigues();
            note("compose_rt_d0", relative(rows(&d0), entry("compose_rt_d0", i)));
            note("compose_rt_d1", relative(rows(&d1), entry("compose_rt_d1", i)));
            let part = |d: &Matrix6<f64>| rows(&d.fixed_view::<3, 3>(0, 0).into_owned());
            note("compose_r_d0", relative(part(&d0), entry("compose_r_d0", i)));
            note("compose_r_d1", relative(part(&d1), entry("compose_r_d1", i)));
        }
        note("compose_r", relative(r.iter().copied(), entry("compose_r", i)));
        let inverse = one.inverse();
        let expected = entry("invert_rt", i);
        let r = full_turns(&inverse, expected);
        note("invert_rt", relative(r.iter().chain(inverse.translation.iter()).copied(), expected));
        if !is_small(rt) {
            let d = inverse.rodrigues_by_tangent() * -inverse.adjoint() * one.tangent_by_rodrigues();
            note("invert_rt_d", relative(rows(&d), entry("invert_rt_d", i)));
        }
    }
    println!("{largest:?}");
    for (name, error) in largest {
        assert!(error <= LIMIT, "{name}: {error:e}");
    }
}
