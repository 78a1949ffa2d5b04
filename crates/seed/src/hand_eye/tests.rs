use super::*;

fn pose(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::from_rodrigues(rotation.into(), translation.into())
}

fn truth() -> HandEye {
    HandEye {
        carrier_from_rig: pose([0.1, -0.2, 1.4], [0.05, -0.03, 0.12]),
        other_from_target: pose([3.0, 0.1, -0.2], [0.8, 0.1, -0.05]),
    }
}

/// Pairs of arm poses whose rotation vectors are `turn(i)`.
fn pairs(n: usize, turn: impl Fn(f64) -> [f64; 3]) -> Vec<PosePair> {
    let pair = |i: usize| {
        let phase = i as f64;
        let translation =
            [0.6 + 0.1 * phase.sin(), 0.2 * (1.7 * phase).cos(), 0.5 + 0.1 * (0.9 * phase).sin()];
        let other_from_carrier = pose(turn(phase), translation);
        PosePair { other_from_carrier, rig_from_target: truth().rig_from_target(&other_from_carrier) }
    };
    (0..n).map(pair).collect()
}

fn difference(one: &Pose, other: &Pose) -> f64 {
    (*one * other.inverse()).log().norm()
}

#[test]
fn all_methods_recover_the_truth_from_exact_poses() {
    for n in [3, 4, 12] {
        let pairs = pairs(n, |i| [0.5 * i.sin(), 0.6 * (2.0 * i).cos(), 0.4 * (3.1 * i).sin()]);
        for method in Method::SIX_AXIS {
            let found = hand_eye(&pairs, method).unwrap_or_else(|| panic!("{method:?} of {n}"));
            let errors = [
                difference(&found.carrier_from_rig, &truth().carrier_from_rig),
                difference(&found.other_from_target, &truth().other_from_target),
            ];
            // Moments square the condition; 1e-7 leaves two digits to each.
            assert!(errors.iter().all(|error| *error < 1e-7), "{method:?} of {n}: {errors:?}");
            let corner = [Vector3::new(0.2, 0.1, 0.0)];
            assert!(found.distance_m(&pairs[0], &corner) < 1e-7);
        }
    }
}

#[test]
fn degenerate_motions_are_refused() {
    let same_axis = pairs(8, |i| [0.0, 0.0, 0.3 * i]);
    let no_turn = pairs(8, |_| [0.3, 0.0, 0.0]);
    let identical = vec![same_axis[1]; 8];
    for method in Method::SIX_AXIS {
        for (name, pairs) in [
            ("one axis", &same_axis[..]),
            ("no turn", &no_turn),
            ("identical", &identical),
            ("two", &same_axis[..2]),
        ] {
            let found = hand_eye(pairs, method);
            assert_eq!(found, None, "{method:?}, {name}");
        }
    }
    assert_eq!(hand_eye(&no_turn, Method::FourAxis), None);
}

#[test]
fn a_four_axis_robot_leaves_only_its_height_open() {
    let pairs = pairs(8, |i| [0.0, 0.0, 0.4 * (1.3 * i).sin()]);
    let found = hand_eye(&pairs, Method::FourAxis).unwrap();
    let error = found.carrier_from_rig.translation - truth().carrier_from_rig.translation;
    assert!(error.xy().norm() < 1e-9, "{error}");
    assert_eq!(found.carrier_from_rig.translation.z, 0.0);
    let turned = found.carrier_from_rig.rotation.angle_to(&truth().carrier_from_rig.rotation);
    assert!(turned < 1e-7, "{turned}");
    // What the rig's height lacks, the target's has: every sight is explained all the same.
    assert!(found.distance_m(&pairs[3], &[Vector3::zeros()]) < 1e-9);
}

#[test]
fn the_spread_of_motions_is_told() {
    let poses =
        |pairs: Vec<PosePair>| -> Vec<Pose> { pairs.iter().map(|pair| pair.other_from_carrier).collect() };
    let one_axis = motion_spread(&poses(pairs(8, |i| [0.0, 0.3 * i, 0.0])));
    assert!(one_axis.second_axis() < 1e-6 && one_axis.axes[0][1].abs() > 0.999, "{one_axis:?}");
    assert_eq!(one_axis.distinct, 8);
    let all = motion_spread(&poses(pairs(8, |i| [0.5 * i.sin(), 0.6 * (2.0 * i).cos(), 0.0])));
    assert!(all.second_axis() > 0.3, "{all:?}");
    let same = motion_spread(&[Pose::identity(); 5]);
    assert_eq!((same.distinct, same.spread), (1, [0.0; 3]));
}
