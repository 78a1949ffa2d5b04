//! mrcal 2.2's six ways to triangulate, with derivatives, `golden_triangulation.npz`.

use boresight_geometry::nalgebra::{Matrix4x3, Vector4};
use boresight_geometry::{Dual, RayPair, Triangulation, Vector3, triangulate};
use boresight_tests::conformance::conformance_file;
use boresight_tests::npz::Npz;

/// Relative to the size of what is compared.
const LIMIT: f64 = 1e-9;

type Number = Dual<f64, 18>;

/// Returns three numbers, along the directions from `first` on.
fn variables(numbers: &[f64], first: usize) -> [Number; 3] {
    [0, 1, 2].map(|axis| Dual::variable(numbers[axis], first + axis))
}

/// Returns the norm of a difference relative to that of what is expected.
fn relative(found: &[f64], expected: &[f64]) -> f64 {
    let norm = |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|x| x * x).sum::<f64>().sqrt();
    let error = norm(&mut found.iter().zip(expected).map(|(a, b)| a - b));
    error / norm(&mut expected.iter().copied())
}

#[test]
fn six_ways_match_mrcal() {
    let Some(path) = conformance_file("mrcal/golden/golden_triangulation.npz") else { return };
    let golden = Npz::read(&path).unwrap();
    let ways = [
        ("geometric", Triangulation::Midpoint),
        ("leecivera_l1", Triangulation::AngleSum),
        ("leecivera_linf", Triangulation::LargestAngle),
        ("leecivera_mid2", Triangulation::AngularMidpoint),
        ("leecivera_wmid2", Triangulation::WeightedMidpoint),
        ("lindstrom", Triangulation::ImageSquaresMrcal22),
    ];
    let rotation = &golden.numbers("Rt01")[..9];
    for (name, way) in ways {
        let is_lindstrom = way == Triangulation::ImageSquaresMrcal22;
        // Only mrcal's Lindstrom has the second ray in its own frame and the rotation as a variable.
        let second = golden.numbers(if is_lindstrom { "v1_local" } else { "v1" });
        let axes = if is_lindstrom { rotation } else { &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0] };
        let (mut largest_value, mut largest_derivative): (f64, f64) = (0.0, 0.0);
        for i in 0..golden.shape("v0")[0] {
            let rays = RayPair {
                ray_in_first: variables(&golden.numbers("v0")[3 * i..], 0),
                ray_in_second: variables(&second[3 * i..], 3),
                rotation: [0, 1, 2].map(|row| variables(&axes[3 * row..], 6 + 3 * row)),
                second_in_first: variables(golden.numbers("t01"), 15),
            };
            let found = triangulate(&rays, way).unwrap_or_else(|| panic!("{name} {i}: no point"));
            let value = found.map(|x| x.value);
            let expected = &golden.numbers(&format!("{name}_m"))[3 * i..3 * i + 3];
            largest_value = largest_value.max(relative(&value, expected));
            let mut check = |array: &str, first: usize, count: usize| {
                let expected =
                    &golden.numbers(&format!("{name}_{array}"))[3 * count * i..3 * count * (i + 1)];
                let found: Vec<f64> =
                    found.iter().flat_map(|x| x.derivative[first..first + count].to_vec()).collect();
                largest_derivative = largest_derivative.max(relative(&found, expected));
            };
            check("dv0", 0, 3);
            check("dv1", 3, 3);
            if is_lindstrom { check("dRt01", 6, 12) } else { check("dt01", 15, 3) }
        }
        println!("{name}: values {largest_value:.1e}, derivatives {largest_derivative:.1e}");
        assert!(largest_value <= LIMIT, "{name}: {largest_value:e}");
        assert!(largest_derivative <= LIMIT, "{name}: {largest_derivative:e}");
    }
}

#[test]
fn ours_is_the_better_optimum() {
    let Some(path) = conformance_file("mrcal/golden/golden_triangulation.npz") else { return };
    let golden = Npz::read(&path).unwrap();
    let three = |name: &str, i: usize| [0, 1, 2].map(|axis| golden.numbers(name)[3 * i + axis]);
    let rotation = [0, 1, 2].map(|row| three("Rt01", row));
    let (mut ours_off, mut theirs_off): (f64, f64) = (0.0, 0.0);
    for i in 0..golden.shape("v0")[0] {
        let rays = RayPair {
            ray_in_first: three("v0", i),
            ray_in_second: three("v1_local", i),
            rotation,
            second_in_first: three("t01", 0),
        };
        // Where the point is seen in both planes z = 1, and the rays there.
        let images = |point: Vector3<f64>| {
            let from_second = point - Vector3::from(rays.second_in_first);
            let axis = |j: usize| (0..3).map(|k| rotation[k][j] * from_second[k]).sum::<f64>();
            Vector4::new(point.x / point.z, point.y / point.z, axis(0) / axis(2), axis(1) / axis(2))
        };
        let [a, b] = [rays.ray_in_first, rays.ray_in_second];
        let seen = Vector4::new(a[0] / a[2], a[1] / a[2], b[0] / b[2], b[1] / b[2]);
        let found = Vector3::from(triangulate(&rays, Triangulation::ImageSquares).unwrap());
        let mut optimum = found;
        for _ in 0..10 {
            // Gauss-Newton, with central differences.
            let step = 1e-5;
            let columns = [0, 1, 2].map(|axis| {
                let by = Vector3::ith(axis, step);
                (images(optimum + by) - images(optimum - by)) / (2.0 * step)
            });
            let jacobian = Matrix4x3::from_columns(&columns);
            let normal = jacobian.transpose() * jacobian;
            let gradient = jacobian.transpose() * (images(optimum) - seen);
            optimum -= normal.cholesky().unwrap().solve(&gradient);
        }
        let theirs = Vector3::from(three("lindstrom_m", i));
        ours_off = ours_off.max((found - optimum).norm() / optimum.norm());
        theirs_off = theirs_off.max((theirs - optimum).norm() / optimum.norm());
    }
    println!("from the optimum: ours {ours_off:.1e}, mrcal's {theirs_off:.1e}");
    assert!(ours_off < 0.5 * theirs_off, "{ours_off:e} against {theirs_off:e}");
}
