//! The point that two rays see: six ways, which differ in the error that they make least.

use crate::Scalar;

/// A way to triangulate two rays that do not quite meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Triangulation {
    /// The middle of the shortest line between the rays.
    Midpoint,
    /// Least squares of the image errors in both planes z = 1: "niter2" of Lindstrom 2010.
    ImageSquares,
    /// What mrcal 2.2 answers in its place, for comparisons with it. It misses the least squares by more: the
    /// last step is multiplied by the inverse of its factor, so that the rays do not quite meet, and the
    /// depth is that of one component. Found from mrcal's answers, which it repeats to rounding.
    ImageSquaresMrcal22,
    /// The least sum of the angles by which the rays must turn: Lee & Civera 2019a.
    AngleSum,
    /// The least larger one of both angles: Lee & Civera 2019a.
    LargestAngle,
    /// The midpoint of the points at the depths of the rays' angles: "mid2" of Lee & Civera 2019b.
    AngularMidpoint,
    /// The same, weighted by the inverse depths: "wmid2" of Lee & Civera 2019b.
    WeightedMidpoint,
}

impl Triangulation {
    /// All ways with their names.
    pub const ALL: [(&'static str, Triangulation); 7] = [
        ("midpoint", Triangulation::Midpoint),
        ("image-squares", Triangulation::ImageSquares),
        ("image-squares-mrcal-2.2", Triangulation::ImageSquaresMrcal22),
        ("angle-sum", Triangulation::AngleSum),
        ("largest-angle", Triangulation::LargestAngle),
        ("angular-midpoint", Triangulation::AngularMidpoint),
        ("weighted-midpoint", Triangulation::WeightedMidpoint),
    ];
}

/// Two rays and how their frames relate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayPair<T> {
    /// The direction of the ray from the origin of the first frame, of any length.
    pub ray_in_first: [T; 3],
    /// The direction of the ray from the origin of the second frame, of any length.
    pub ray_in_second: [T; 3],
    /// The rotation `first_from_second`, row by row.
    pub rotation: [[T; 3]; 3],
    /// The origin of the second frame, given in the first.
    pub second_in_first: [T; 3],
}

/// Returns the point that both rays see, in the first frame, or `None` where they do not meet in
/// front of both origins: parallel or diverging rays.
///
/// Derivatives come with dual numbers for `T`.
pub fn triangulate<T: Scalar>(rays: &RayPair<T>, way: Triangulation) -> Option<[T; 3]> {
    let t = rays.second_in_first;
    let second = rotated(&rays.rotation, rays.ray_in_second);
    match way {
        Triangulation::Midpoint => midpoint(rays.ray_in_first, second, t),
        Triangulation::ImageSquares => {
            let [a, b] = corrected(rays, |shorter, longer| longer / shorter)?;
            meeting(a, b, t)
        }
        Triangulation::ImageSquaresMrcal22 => {
            let [a, b] = corrected(rays, |shorter, longer| shorter / longer)?;
            meeting_in_one_component(a, b, t)
        }
        Triangulation::AngleSum => angle_sum(unit(rays.ray_in_first)?, unit(second)?, t),
        Triangulation::LargestAngle => largest_angle(unit(rays.ray_in_first)?, unit(second)?, t),
        Triangulation::AngularMidpoint => angular_midpoint(unit(rays.ray_in_first)?, unit(second)?, t, false),
        Triangulation::WeightedMidpoint => angular_midpoint(unit(rays.ray_in_first)?, unit(second)?, t, true),
    }
}

/// Returns the middle of the points at `k0 a` and `t + k1 b` that are nearest to each other.
fn midpoint<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3]) -> Option<[T; 3]> {
    let (aa, ab, bb) = (dot(a, a), dot(a, b), dot(b, b));
    let (at, bt) = (dot(a, t), dot(b, t));
    let determinant = aa * bb - ab * ab;
    if !determinant.all_above(0.0) {
        return None;
    }
    let along_a = (at * bb - ab * bt) / determinant;
    let along_b = (at * ab - aa * bt) / determinant;
    if !(along_a.all_above(0.0) && along_b.all_above(0.0)) {
        return None;
    }
    let both = add(add(scaled(a, along_a), t), scaled(b, along_b));
    Some(scaled(both, along_a.like(0.5)))
}

/// Returns the rays that meet at the point whose images in both planes z = 1 are nearest to the rays', in
/// two iterations; both are in the first frame.
///
/// Listing 3, "niter2", of Lindstrom, "Triangulation made easy", 2010, with its symbols; the factor of the
/// second iteration is made of `nᵀn + n'ᵀn'` and `2d`.
fn corrected<T: Scalar>(rays: &RayPair<T>, factor: impl Fn(T, T) -> T) -> Option<[[T; 3]; 2]> {
    let RayPair { ray_in_first, ray_in_second, rotation, second_in_first: t } = *rays;
    if !(ray_in_first[2].all_above(0.0) && ray_in_second[2].all_above(0.0)) {
        return None;
    }
    let zero = t[0].like(0.0);
    let onto_plane = |ray: [T; 3]| [ray[0] / ray[2], ray[1] / ray[2], zero.like(1.0)];
    let (mut x, mut y) = (onto_plane(ray_in_first), onto_plane(ray_in_second));
    // The essential matrix: xᵀ E y = 0 where the rays meet.
    let column = |j: usize| cross(t, [rotation[0][j], rotation[1][j], rotation[2][j]]);
    let columns = [column(0), column(1), column(2)];
    let e = |i: usize, j: usize| columns[j][i];
    let times =
        |y: [T; 3]| add(add(scaled(columns[0], y[0]), scaled(columns[1], y[1])), scaled(columns[2], y[2]));
    let ey = times(y);
    let mut n = [ey[0], ey[1]];
    let mut m = [dot(columns[0], x), dot(columns[1], x)];
    let a = n[0] * (e(0, 0) * m[0] + e(0, 1) * m[1]) + n[1] * (e(1, 0) * m[0] + e(1, 1) * m[1]);
    let square = |n: [T; 2], m: [T; 2]| n[0] * n[0] + n[1] * n[1] + m[0] * m[0] + m[1] * m[1];
    let b = square(n, m).scale(0.5);
    let c = dot(x, ey);
    let discriminant = b * b - a * c;
    if !discriminant.all_above(0.0) {
        return None;
    }
    let d = discriminant.sqrt();
    let mut lambda = c / (b + d);
    let (dx, dy) = ([lambda * n[0], lambda * n[1]], [lambda * m[0], lambda * m[1]]);
    n = [n[0] - (e(0, 0) * dy[0] + e(0, 1) * dy[1]), n[1] - (e(1, 0) * dy[0] + e(1, 1) * dy[1])];
    m = [m[0] - (e(0, 0) * dx[0] + e(1, 0) * dx[1]), m[1] - (e(0, 1) * dx[0] + e(1, 1) * dx[1])];
    lambda = lambda * factor(square(n, m), d.scale(2.0));
    x = [x[0] - lambda * n[0], x[1] - lambda * n[1], x[2]];
    y = [y[0] - lambda * m[0], y[1] - lambda * m[1], y[2]];
    Some([x, rotated(&rotation, y)])
}

/// Turns the ray that makes the smaller angle with the baseline into the plane of the other.
fn angle_sum<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3]) -> Option<[T; 3]> {
    let (across_a, across_b) = (cross(a, t), cross(b, t));
    let nearer = dot(across_a, across_a) - dot(across_b, across_b);
    if nearer.all_above(0.0) {
        meeting(a, without(b, unit(across_a)?), t)
    } else {
        meeting(without(a, unit(across_b)?), b, t)
    }
}

/// Turns both rays into the plane through the baseline that is equally far from them.
fn largest_angle<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3]) -> Option<[T; 3]> {
    let (sum, difference) = (cross(add(a, b), t), cross(minus(a, b), t));
    let longer = dot(sum, sum) - dot(difference, difference);
    let normal = unit(if longer.all_above(0.0) { sum } else { difference })?;
    meeting(without(a, normal), without(b, normal), t)
}

/// Returns the midpoint of the points on the unit rays at the depths that the angles between rays and
/// baseline give; `is_weighted` weighs each by its inverse depth.
fn angular_midpoint<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3], is_weighted: bool) -> Option<[T; 3]> {
    let between = norm(cross(a, b))?;
    let (depth_a, depth_b) = (norm(cross(b, t))? / between, norm(cross(a, t))? / between);
    let (on_a, from_second) = (scaled(a, depth_a), scaled(b, depth_b));
    // Eq. 13 of Lee & Civera 2019b: depths without a sign belong to rays that meet in front only if no
    // other signs bring their ends nearer.
    let gap = |sign_a: f64, sign_b: f64| {
        let gap = minus(add(t, scaled(from_second, t[0].like(sign_b))), scaled(on_a, t[0].like(sign_a)));
        dot(gap, gap)
    };
    let own = gap(1.0, 1.0);
    if [(-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].iter().any(|&(a, b)| !(gap(a, b) - own).all_above(0.0)) {
        return None;
    }
    let on_b = add(t, from_second);
    let total = depth_a + depth_b;
    let half = total.like(0.5);
    let (weight_a, weight_b) = if is_weighted { (depth_b / total, depth_a / total) } else { (half, half) };
    Some(add(scaled(on_a, weight_a), scaled(on_b, weight_b)))
}

/// Returns where rays in one plane with the baseline meet, or `None` behind an origin.
fn meeting<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3]) -> Option<[T; 3]> {
    let z = cross(a, b);
    let square = dot(z, z);
    if !square.all_above(0.0) {
        return None;
    }
    let (along_a, along_b) = (dot(z, cross(t, b)) / square, dot(z, cross(t, a)) / square);
    (along_a.all_above(0.0) && along_b.all_above(0.0)).then(|| scaled(a, along_a))
}

/// Does what [`meeting`] does by one component alone of the rays' cross product, the larger one of x and y;
/// it differs where they do not quite meet.
fn meeting_in_one_component<T: Scalar>(a: [T; 3], b: [T; 3], t: [T; 3]) -> Option<[T; 3]> {
    meeting(a, b, t)?;
    let (z, across) = (cross(a, b), cross(t, b));
    let axis = usize::from((z[1] * z[1] - z[0] * z[0]).all_above(0.0));
    Some(scaled(a, across[axis] / z[axis]))
}

/// Returns `ray` less its part along the unit `normal`.
fn without<T: Scalar>(ray: [T; 3], normal: [T; 3]) -> [T; 3] {
    minus(ray, scaled(normal, dot(ray, normal)))
}

fn dot<T: Scalar>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross<T: Scalar>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn add<T: Scalar>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn minus<T: Scalar>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn scaled<T: Scalar>(a: [T; 3], factor: T) -> [T; 3] {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

fn rotated<T: Scalar>(rotation: &[[T; 3]; 3], a: [T; 3]) -> [T; 3] {
    [dot(rotation[0], a), dot(rotation[1], a), dot(rotation[2], a)]
}

/// Returns the length, or `None` of a vector that has none.
fn norm<T: Scalar>(a: [T; 3]) -> Option<T> {
    let square = dot(a, a);
    square.all_above(0.0).then(|| square.sqrt())
}

fn unit<T: Scalar>(a: [T; 3]) -> Option<[T; 3]> {
    let length = norm(a)?;
    Some(scaled(a, length.like(1.0) / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Dual, Pose, Vector3};

    fn pose() -> Pose {
        Pose::from_rodrigues(Vector3::new(0.05, -0.3, 0.1), Vector3::new(1.2, 0.1, -0.2))
    }

    /// Returns the pair that sees `point`, with the second ray off by `error` in its plane z = 1.
    fn pair(point: [f64; 3], error: [f64; 2]) -> RayPair<f64> {
        let in_second = pose().inverse() * Vector3::from(point);
        let rotation = pose().rotation_matrix();
        RayPair {
            ray_in_first: point,
            ray_in_second: [in_second.x / in_second.z + error[0], in_second.y / in_second.z + error[1], 1.0],
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])),
            second_in_first: pose().translation.into(),
        }
    }

    const POINTS: [[f64; 3]; 4] = [[0.3, -0.2, 4.0], [-2.0, 1.0, 5.0], [0.5, 0.3, 30.0], [3.0, 2.0, 3.0]];

    #[test]
    fn all_ways_find_a_point_without_noise() {
        for (name, way) in Triangulation::ALL {
            for point in POINTS {
                let found = triangulate(&pair(point, [0.0; 2]), way).unwrap();
                let error = (Vector3::from(found) - Vector3::from(point)).norm();
                // Rounding, amplified by distance over baseline squared.
                assert!(error < 1e-12 * point[2] * point[2], "{name}: {found:?}");
            }
        }
    }

    #[test]
    fn diverging_and_parallel_rays_do_not_meet() {
        for (name, way) in Triangulation::ALL {
            let mut rays = pair([0.0, 0.0, 5.0], [0.0; 2]);
            // The second ray now leaves to the other side.
            rays.ray_in_second = (pose().rotation.inverse() * Vector3::new(0.4, 0.0, 1.0)).into();
            assert_eq!(triangulate(&rays, way), None, "{name}");
            rays.ray_in_second = [0.0, 0.0, 1.0];
            rays.rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            assert_eq!(triangulate(&rays, way), None, "{name}");
        }
    }

    /// Returns the images of a point in both planes z = 1.
    fn images(point: Vector3<f64>) -> [f64; 4] {
        let other = pose().inverse() * point;
        [point.x / point.z, point.y / point.z, other.x / other.z, other.y / other.z]
    }

    #[test]
    fn each_way_makes_its_own_error_least() {
        for point in POINTS {
            let rays = pair(point, [1e-3, -2e-3]);
            let seen = [
                rays.ray_in_first[0] / rays.ray_in_first[2],
                rays.ray_in_first[1] / rays.ray_in_first[2],
                rays.ray_in_second[0],
                rays.ray_in_second[1],
            ];
            let squares = |point: Vector3<f64>| -> f64 {
                images(point).iter().zip(seen).map(|(a, b)| (a - b) * (a - b)).sum()
            };
            let angles = |point: Vector3<f64>| {
                let angle = |a: Vector3<f64>, b: Vector3<f64>| a.cross(&b).norm().atan2(a.dot(&b));
                let other = pose().inverse() * point;
                [
                    angle(point, Vector3::from(rays.ray_in_first)),
                    angle(other, Vector3::from(rays.ray_in_second)),
                ]
            };
            let check = |way: Triangulation, cost: &dyn Fn(Vector3<f64>) -> f64| {
                let best = Vector3::from(triangulate(&rays, way).unwrap());
                let step = 1e-5 * best.z;
                for axis in 0..3 {
                    for sign in [-1.0, 1.0] {
                        let mut moved = best;
                        moved[axis] += sign * step;
                        // The two iterations end within 1e-9 of the least cost.
                        assert!(cost(moved) > cost(best) * (1.0 - 1e-9), "{way:?} {point:?}");
                    }
                }
            };
            check(Triangulation::ImageSquares, &squares);
            check(Triangulation::AngleSum, &|p| angles(p).iter().sum());
            check(Triangulation::LargestAngle, &|p| angles(p)[0].max(angles(p)[1]));
        }
    }

    #[test]
    fn derivatives_match_differences() {
        for (name, way) in Triangulation::ALL {
            let rays = pair(POINTS[1], [1e-3, -2e-3]);
            let numbers = |rays: &RayPair<f64>| {
                let mut all = rays.ray_in_first.to_vec();
                all.extend(rays.ray_in_second);
                all.extend(rays.rotation.concat());
                all.extend(rays.second_in_first);
                all
            };
            let dual = |i: usize, k: usize| {
                let value = numbers(&rays)[i];
                if i == k { Dual::<f64, 1>::variable(value, 0) } else { Dual::fixed(value) }
            };
            for k in 0..18 {
                let of = |first: usize| [0, 1, 2].map(|axis| dual(first + axis, k));
                let duals = RayPair {
                    ray_in_first: of(0),
                    ray_in_second: of(3),
                    rotation: [of(6), of(9), of(12)],
                    second_in_first: of(15),
                };
                let found = triangulate(&duals, way).unwrap();
                let moved = |step: f64| {
                    let mut all = numbers(&rays);
                    all[k] += step;
                    let of = |first: usize| [0, 1, 2].map(|axis| all[first + axis]);
                    let moved = RayPair {
                        ray_in_first: of(0),
                        ray_in_second: of(3),
                        rotation: [of(6), of(9), of(12)],
                        second_in_first: of(15),
                    };
                    triangulate(&moved, way).unwrap()
                };
                let step = 1e-6;
                let (plus, minus) = (moved(step), moved(-step));
                for axis in 0..3 {
                    let difference = (plus[axis] - minus[axis]) / (2.0 * step);
                    let error = (found[axis].derivative[0] - difference).abs();
                    // A central difference of values near 10.
                    assert!(error < 1e-6, "{name} {k}: {error}");
                }
            }
        }
    }
}
