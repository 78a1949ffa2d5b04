//! Which views a lens is fitted to: few, and as different as they come.

use crate::radial::RadialPose;
use crate::robust::median;
use crate::sighting::Sighting;

/// Returns the indices of at most `limit` sightings, spread over image place, size and tilt, in
/// increasing order: farthest-point selection (Gonzalez 1985), which is deterministic.
pub(crate) fn diverse_subset(
    sightings: &[Sighting],
    radials: &[Option<RadialPose>],
    image_size: [u32; 2],
    limit: usize,
) -> Vec<usize> {
    let spreads: Vec<f64> = radials.iter().flatten().map(|radial| radial.spread_px).collect();
    let spread_limit = 4.0 * median(&spreads).max(0.05);
    let counts: Vec<f64> = sightings.iter().map(|sighting| sighting.len() as f64).collect();
    let count_limit = 0.5 * median(&counts);
    let is_solid = |i: &usize| {
        counts[*i] >= count_limit
            && radials[*i].as_ref().is_some_and(|radial| radial.spread_px <= spread_limit)
    };
    let mut candidates: Vec<usize> = (0..sightings.len()).filter(is_solid).collect();
    if candidates.len() < limit.min(sightings.len()) {
        candidates = (0..sightings.len()).collect();
    }
    if candidates.len() <= limit {
        return candidates;
    }
    let unit_px = f64::from(image_size[0].max(image_size[1]));
    let features: Vec<[f64; 6]> =
        candidates.iter().map(|&i| features(&sightings[i], radials[i].as_ref(), unit_px)).collect();
    let distance = |a: &[f64; 6], b: &[f64; 6]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    // The largest in the image comes first.
    let first =
        (0..candidates.len()).max_by(|&a, &b| features[a][2].total_cmp(&features[b][2])).unwrap_or_default();
    let mut chosen = vec![first];
    let mut nearest: Vec<f64> = features.iter().map(|feature| distance(feature, &features[first])).collect();
    while chosen.len() < limit {
        let Some(next) = (0..candidates.len()).max_by(|&a, &b| nearest[a].total_cmp(&nearest[b])) else {
            break;
        };
        for (near, feature) in nearest.iter_mut().zip(&features) {
            *near = near.min(distance(feature, &features[next]));
        }
        chosen.push(next);
    }
    let mut subset: Vec<usize> = chosen.into_iter().map(|i| candidates[i]).collect();
    subset.sort_unstable();
    subset.dedup();
    subset
}

/// Returns place and size in the image, and the tilt up to its sign, all of the order of one.
fn features(sighting: &Sighting, radial: Option<&RadialPose>, unit_px: f64) -> [f64; 6] {
    let n = sighting.len() as f64;
    let mean = [0, 1].map(|axis| sighting.pixels.iter().map(|pixel| pixel[axis]).sum::<f64>() / n);
    let square: f64 =
        sighting.pixels.iter().map(|[u, v]| (u - mean[0]).powi(2) + (v - mean[1]).powi(2)).sum();
    // The z row of the rotation is known up to its sign; its products are free of it.
    let [p, q] = radial.map_or([0.0; 2], |radial| [radial.rotation[(2, 0)], radial.rotation[(2, 1)]]);
    [
        mean[0] / unit_px,
        mean[1] / unit_px,
        (square / n).sqrt() / unit_px,
        p * p - q * q,
        2.0 * p * q,
        p * p + q * q,
    ]
}
