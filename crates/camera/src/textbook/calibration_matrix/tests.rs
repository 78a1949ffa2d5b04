use proptest::prelude::*;

use super::*;
use crate::textbook::{h_matrix, project_by_h};

const CORE: [f64; 4] = [1200.0, 1190.0, 800.5, 610.0];

fn cam_from_ref() -> Pose {
    Pose::from_rodrigues(Vector3::new(0.3, -0.5, 0.2), Vector3::new(-0.1, 0.05, 1.4))
}

/// Returns points on three layers, `thickness` apart, which `h` sees.
fn layers(h: &Matrix3x4<f64>, thickness: f64) -> Vec<PointPair> {
    let mut pairs = Vec::new();
    for (i, j, k) in (0..4).flat_map(|i| (0..4).flat_map(move |j| (0..3).map(move |k| (i, j, k)))) {
        let point_in_ref = Point3::new(0.1 * f64::from(i), 0.1 * f64::from(j), thickness * f64::from(k));
        let projection = project_by_h(h, &point_in_ref).unwrap();
        pairs.push(PointPair { point_in_ref, pixel: [projection.u, projection.v] });
    }
    pairs
}

/// Returns a deterministic number in [-1, 1] with mean zero.
fn noise(state: &mut u64) -> f64 {
    // Knuth's linear congruential generator (MMIX).
    *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

#[test]
fn truth_is_found() {
    let truth = h_matrix(CORE, &cam_from_ref());
    let pairs = layers(&truth, 0.1);
    // All points, and exactly as many as are needed: six in general position.
    for pairs in [pairs.clone(), [0, 9, 14, 28, 35, 47].map(|i| pairs[i]).to_vec()] {
        let estimate = from_points(&pairs).unwrap();
        // 1e-13 px of rounding over a baseline of a third of a metre, magnified by six points.
        assert!((estimate.h - truth).norm() < 1e-8, "{}", estimate.h - truth);
        assert!(estimate.rms_px < 1e-10);
        let parts = decompose(&estimate.h).unwrap();
        for (found, expected) in parts.core.iter().zip(CORE) {
            assert!((found - expected).abs() < 1e-8);
        }
        assert!(parts.skew_px.abs() < 1e-8);
        assert!((parts.cam_from_ref * cam_from_ref().inverse()).log().norm() < 1e-10);
    }
}

#[test]
fn noise_moves_the_answer_no_further_than_it_must() {
    let truth = h_matrix(CORE, &cam_from_ref());
    let mut state = 7;
    // Uniform in [-a, a] has sigma a/√3.
    const SIGMA: f64 = 0.3;
    let mut pairs = layers(&truth, 0.1);
    for pair in &mut pairs {
        pair.pixel = pair.pixel.map(|x| x + SIGMA * 3f64.sqrt() * noise(&mut state));
    }
    let estimate = from_points(&pairs).unwrap();
    // 96 residuals less 11 unknowns: the RMS distance per point is sigma √(2 · 85/96), within 4 of
    // its standard errors of 1/√(2 · 85).
    let expected = SIGMA * (2.0f64 * 85.0 / 96.0).sqrt();
    assert!((estimate.rms_px / expected - 1.0).abs() < 4.0 / 170f64.sqrt(), "{}", estimate.rms_px);
    let rms_of_truth = {
        let squares = pairs.iter().map(|pair| {
            let seen = project_by_h(&truth, &pair.point_in_ref).unwrap();
            (seen.u - pair.pixel[0]).powi(2) + (seen.v - pair.pixel[1]).powi(2)
        });
        (squares.sum::<f64>() / pairs.len() as f64).sqrt()
    };
    assert!(estimate.rms_px < rms_of_truth);
    let parts = decompose(&estimate.h).unwrap();
    // The fit is the best one: no change of H improves it.
    for (row, column) in [(0, 0), (1, 1), (0, 3), (2, 3)] {
        for factor in [1.0 - 1e-6, 1.0 + 1e-6] {
            let mut h = estimate.h;
            h[(row, column)] *= factor;
            let squares = pairs.iter().map(|pair| {
                let seen = project_by_h(&h, &pair.point_in_ref).unwrap();
                (seen.u - pair.pixel[0]).powi(2) + (seen.v - pair.pixel[1]).powi(2)
            });
            assert!((squares.sum::<f64>() / pairs.len() as f64).sqrt() >= estimate.rms_px);
        }
    }
    // Single shots of a third of a pixel on a 0.3 m object at 1.4 m: percents of the focal length.
    assert!((parts.core[0] / CORE[0] - 1.0).abs() < 0.02, "{:?}", parts.core);
    assert!(parts.core[0] > 0.0 && parts.core[1] > 0.0);
}

#[test]
fn degenerate_points_are_named() {
    let truth = h_matrix(CORE, &cam_from_ref());
    let good = layers(&truth, 0.1);

    assert_eq!(from_points(&[]), Err(Error::TooFewPoints { found: 0, need: 6 }));
    assert_eq!(from_points(&good[..5]), Err(Error::TooFewPoints { found: 5, need: 6 }));
    let repeated: Vec<_> = good[..5].iter().cycle().take(20).copied().collect();
    assert_eq!(from_points(&repeated), Err(Error::TooFewPoints { found: 5, need: 6 }));

    let mut broken = good.clone();
    broken[3].pixel[1] = f64::NAN;
    assert_eq!(from_points(&broken), Err(Error::PointNotFinite { index: 3 }));

    for thickness in [0.0, 1e-6, 5e-4] {
        let error = from_points(&layers(&truth, thickness)).unwrap_err();
        let Error::Coplanar { ratio, limit } = error else { panic!("{error}") };
        assert!(ratio < limit && limit == MIN_THICKNESS);
    }
    let tilted: Vec<_> = layers(&truth, 0.0)
        .iter()
        .map(|pair| PointPair {
            point_in_ref: Pose::exp(&[1.0, 2.0, 0.5, 9.0, 8.0, 7.0].into()) * pair.point_in_ref,
            ..*pair
        })
        .collect();
    assert!(matches!(from_points(&tilted), Err(Error::Coplanar { ratio, .. }) if ratio < 1e-14));

    let mut same_pixel = good.clone();
    same_pixel.iter_mut().for_each(|pair| pair.pixel = [10.0, 20.0]);
    assert!(matches!(from_points(&same_pixel), Err(Error::BadRank { .. })));

    // A plane and one point off it leave one degree of freedom open, with noise or without.
    let mut almost = layers(&truth, 0.1);
    almost.retain(|pair| pair.point_in_ref.z == 0.0);
    almost.insert(3, good[20]);
    for amplitude in [0.0, 0.2] {
        let mut state = 3;
        almost.iter_mut().for_each(|pair| pair.pixel[0] += amplitude * noise(&mut state));
        assert!(
            matches!(from_points(&almost), Err(Error::CoplanarButOne { index: 3, ratio, .. }) if ratio < 1e-6)
        );
    }
    // Points on a twisted cubic (t, t², t³) through the centre of projection leave it open too.
    let cubic: Vec<_> = (1..12)
        .map(|i| 0.1 * f64::from(i))
        .map(|t| {
            (
                cam_from_ref().inverse() * Point3::new(t * t, t * t * t, t),
                [CORE[0] * t + 800.5, CORE[1] * t * t + 610.0],
            )
        })
        .map(|(point_in_ref, pixel)| PointPair { point_in_ref, pixel })
        .collect();
    assert!(matches!(from_points(&cubic), Err(Error::BadRank { .. })), "{:?}", from_points(&cubic));

    let mut mirrored = good.clone();
    mirrored.iter_mut().for_each(|pair| pair.pixel[0] = 1600.0 - pair.pixel[0]);
    assert_eq!(from_points(&mirrored), Err(Error::BehindCamera { behind: 48, of: 48 }));
}

#[test]
fn mismatched_points_are_refused_or_show_in_the_fit() {
    let truth = h_matrix(CORE, &cam_from_ref());
    let mut pairs = layers(&truth, 0.1);
    let pixels: Vec<_> = pairs.iter().rev().map(|pair| pair.pixel).collect();
    pairs.iter_mut().zip(pixels).for_each(|(pair, pixel)| pair.pixel = pixel);
    pairs.swap(3, 17);
    pairs.iter_mut().step_by(5).for_each(|pair| pair.pixel.reverse());
    if let Ok(estimate) = from_points(&pairs) {
        assert!(estimate.rms_px > 10.0, "{}", estimate.rms_px);
    }
}

#[test]
fn bad_matrices_are_named() {
    let mut h = h_matrix(CORE, &cam_from_ref());
    h[(1, 2)] = f64::INFINITY;
    assert_eq!(decompose(&h), Err(Error::MatrixNotFinite { row: 1, column: 2 }));
    assert!(matches!(decompose(&Matrix3x4::zeros()), Err(Error::Singular { ratio: 0.0, .. })));
    // An affine camera: its centre is at infinity.
    let affine = Matrix3x4::new(1.0, 2.0, 3.0, 4.0, 4.0, 3.0, 1.0, 5.0, 0.0, 0.0, 0.0, 1.0);
    assert!(matches!(decompose(&affine), Err(Error::Singular { .. })));
    let text = Error::Coplanar { ratio: 1.234e-4, limit: MIN_THICKNESS }.to_string();
    assert!(text.contains("1.2e-4") && text.contains("5.0e-3"), "{text}");
}

proptest! {
    #[test]
    fn parts_multiply_to_the_matrix(
        fx in 100.0..5000.0f64, aspect in 0.5..2.0f64, skew in -50.0..50.0f64,
        centre in prop::array::uniform2(-500.0..3000.0f64),
        rotation in prop::array::uniform3(-1.8..1.8f64), translation in prop::array::uniform3(-5.0..5.0f64),
        scale in prop::sample::select(vec![1.0, -1.0, 1e-6, -3e4]),
    ) {
        let cam_from_ref = Pose::from_rodrigues(rotation.into(), translation.into());
        let parts = Parts { core: [fx, fx * aspect, centre[0], centre[1]], skew_px: skew, cam_from_ref };
        let found = decompose(&(parts.p() * parts.m() * scale)).unwrap();
        // Pixels of thousands, and centres that are left over from differences of such numbers.
        for (found, expected) in found.core.iter().zip(parts.core) {
            prop_assert!((found - expected).abs() < 1e-9);
        }
        prop_assert!((found.skew_px - skew).abs() < 1e-9);
        prop_assert!((found.p() * found.m() - parts.p() * parts.m()).norm() < 1e-8);
        prop_assert!((found.cam_from_ref * cam_from_ref.inverse()).log().norm() < 1e-10);
    }
}
