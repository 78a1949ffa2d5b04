//! Combinations of parameters that the data hardly tell apart, in numbers and in words.

use std::collections::BTreeMap;

use boresight_data::LooseDirection;

/// A combination is loose if its sigma is so many times what the parameters' own would be one by one.
///
/// Radial coefficients of a good calibration reach a few hundred.
pub(crate) const INFLATION_ABOVE: f64 = 3e3;

/// The most combinations that are reported.
const MOST: usize = 3;

/// Steps of the power method; the loose directions stand far apart from the others, so few are needed.
const STEPS: usize = 60;

/// A parameter whose share is below this plays no part.
const LEAST_SHARE: f64 = 0.05;

/// Returns the loose combinations of parameters.
///
/// `covariance` holds a row for each of `names`, `information` what would be known of each if all others
/// were. Scaled by the latter, a covariance with eigenvalue `e` means `sqrt(e)` times the sigma. A direction that is
/// found is taken out before the next is looked for.
pub(crate) fn loose_directions(
    names: &[String],
    covariance: &[f64],
    information: &[f64],
) -> Vec<LooseDirection> {
    let n = names.len();
    let root: Vec<f64> = information.iter().map(|information| information.max(0.0).sqrt()).collect();
    let mut found: Vec<(f64, Vec<f64>)> = Vec::new();
    for _ in 0..MOST.min(n) {
        let mut direction: Vec<f64> = (0..n).map(|i| 1.0 + (i as f64 * 0.618_034).fract()).collect();
        let mut eigenvalue = 0.0;
        for _ in 0..STEPS {
            for (_, known) in &found {
                let along: f64 = known.iter().zip(&direction).map(|(a, b)| a * b).sum();
                direction.iter_mut().zip(known).for_each(|(x, known)| *x -= along * known);
            }
            let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
            if norm == 0.0 || !norm.is_finite() {
                return describe(names, found);
            }
            let scaled: Vec<f64> = direction.iter().zip(&root).map(|(x, root)| x / norm * root).collect();
            direction = covariance
                .chunks_exact(n)
                .zip(&root)
                .map(|(row, root)| root * row.iter().zip(&scaled).map(|(a, b)| a * b).sum::<f64>())
                .collect();
            eigenvalue = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        }
        let inflation = eigenvalue.sqrt();
        if !inflation.is_finite() || inflation <= INFLATION_ABOVE {
            break;
        }
        direction.iter_mut().for_each(|x| *x /= eigenvalue);
        found.push((inflation, direction));
    }
    describe(names, found)
}

fn describe(names: &[String], found: Vec<(f64, Vec<f64>)>) -> Vec<LooseDirection> {
    let describe = |(inflation, direction): (f64, Vec<f64>)| {
        let mut parts: Vec<(String, f64)> =
            names.iter().zip(&direction).map(|(name, x)| (name.clone(), x * x)).collect();
        parts.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        parts.retain(|(_, share)| *share > LEAST_SHARE);
        let names: Vec<&str> = parts.iter().map(|(name, _)| name.as_str()).collect();
        LooseDirection { inflation, words: in_words(&names), parts }
    };
    found.into_iter().map(describe).collect()
}

/// Says which parameters cannot be told apart and what would tell them apart, such as
/// "cx and yaw of camera right are not separable: tilt the board".
pub(crate) fn in_words(names: &[&str]) -> String {
    let mut by_owner: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut owners: Vec<&str> = Vec::new();
    for name in names {
        let (owner, parameter) = name.split_once('.').unwrap_or(("", name));
        if !owners.contains(&owner) {
            owners.push(owner);
        }
        by_owner.entry(owner).or_default().push(parameter);
    }
    let said: Vec<String> = owners
        .iter()
        .filter_map(|owner| {
            let parameters: Vec<String> = by_owner.get(owner)?.iter().map(|name| plain(name)).collect();
            Some(if owner.is_empty() { and(&parameters) } else { format!("{} of {owner}", and(&parameters)) })
        })
        .collect();
    let verb = match names.len() {
        0 => return "the parameters are not separable".to_owned(),
        1 => "is not determined",
        _ => "are not separable",
    };
    format!("{} {verb}: {}", and(&said), remedy(names))
}

/// Returns the plain name of a parameter without its owner.
fn plain(parameter: &str) -> String {
    let word = match parameter.rsplit('.').next().unwrap_or(parameter) {
        "rx_rad" => "pitch",
        "ry_rad" => "yaw",
        "rz_rad" => "roll",
        "tx_m" => "sideways position",
        "ty_m" => "height",
        "tz_m" => "distance",
        "shape0_m" => "bend along x",
        "shape1_m" => "bend along y",
        "shape2_m" => "twist",
        "shape3_m" => "change of the bend along x",
        "shape4_m" => "change of the bend along y",
        "shape5_m" => "bend of the middle",
        "time_offset_s" => "time offset",
        "line_delay_s" => "line delay",
        other => other,
    };
    word.to_owned()
}

/// Returns what would tell some parameters apart.
fn remedy(names: &[&str]) -> &'static str {
    let ends_in =
        |ends: &[&str]| names.iter().any(|name| ends.contains(&name.rsplit('.').next().unwrap_or(name)));
    let has_pose = ends_in(&["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"]);
    if ends_in(&["time_offset_s"]) {
        "move the board while the cameras look at it together"
    } else if ends_in(&["line_delay_s"]) {
        "move the board faster, in all directions"
    } else if ends_in(&["fx", "fy"]) || (has_pose && ends_in(&["cx", "cy"])) {
        "tilt the board by 20 to 45 degrees about both axes"
    } else if ends_in(&["cx", "cy", "p1", "p2"]) {
        "tilt the board, and roll it by 90 degrees between views"
    } else if has_pose {
        "show the board to these cameras at once, in more places"
    } else if names.iter().any(|name| name.rsplit('.').next().is_some_and(|end| end.starts_with("shape"))) {
        "tilt the board and roll it by 90 degrees, or take it as flat"
    } else {
        "bring corners to the borders of the image, or take a lens model with fewer parameters"
    }
}

fn and(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_said_in_words() {
        for (names, words) in [
            (
                &["right.cx", "right.cam_from_rig.ry_rad"][..],
                "cx and yaw of right are not separable: tilt the board by 20 to 45 degrees about both axes",
            ),
            (
                &["left.fx", "left.fy", "right.cam_from_rig.tz_m"],
                "fx and fy of left and distance of right are not separable: tilt the board by 20 to 45 degrees about both axes",
            ),
            (
                &["left.k1", "left.k4"],
                "k1 and k4 of left are not separable: bring corners to the borders of the image, or take a lens model with fewer parameters",
            ),
            (
                &["left.cy"],
                "cy of left is not determined: tilt the board, and roll it by 90 degrees between views",
            ),
        ] {
            assert_eq!(in_words(names), words);
        }
    }

    #[test]
    fn a_loose_combination_is_found_among_sound_ones() {
        // a - b is known to 1e-2 and a + b to 1e4; c to 1.
        let names = ["left.a", "left.b", "left.c"].map(str::to_owned);
        let (loose, tight) = (1e8, 1e-4);
        let (own, cross) = (0.5 * (loose + tight), 0.5 * (loose - tight));
        let covariance = [own, cross, 0.0, cross, own, 0.0, 0.0, 0.0, 1.0];
        // The inverse's diagonal.
        let own_information = 0.5 * (1.0 / loose + 1.0 / tight);
        let found = loose_directions(&names, &covariance, &[own_information, own_information, 1.0]);
        assert_eq!(found.len(), 1, "{found:?}");
        // The scaled covariance's eigenvalue along (1, 1) is 1e8 times the information 5e3.
        assert!((found[0].inflation - (loose * own_information).sqrt()).abs() < 1e-3);
        let names: Vec<&str> = found[0].parts.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["left.a", "left.b"]);
        assert!(found[0].parts.iter().all(|(_, share)| (share - 0.5).abs() < 1e-9));
        assert_eq!(loose_directions(&[], &[], &[]), []);
    }
}
