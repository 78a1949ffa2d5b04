//! The distances of three points along three rays, from the sides of their triangle: Eqs 8.15 and 8.16.
//!
//! With unit rays `y_i` and points `d_i y_i`, the sides say `d_i² + d_j² - 2 d_i d_j y_i·y_j = a_ij`
//! (Grunert 1841). Their ratios are where two conics meet; as Persson & Nordberg 2018 and Ding et al.
//! 2023 do, a degenerate conic of their pencil is taken apart into two lines, each of which meets
//! another conic in two points. What is particular here:
//!
//! - The unknowns are how far the ratios depart from one, in units of the angles between the rays:
//!   `d_2 = d_1 (1 + s x)`, `d_3 = d_1 (1 + s y)`. A side is then `s² d_1² q` with a quadratic `q` whose
//!   coefficients are of the order of one however small the triangle looks, and no cosine close to
//!   one is ever subtracted from another.
//! - Of three real degenerate conics the one is taken whose root stands apart from the others. Where two
//!   solutions merge the other two roots merge too, but this one stays well determined.
//! - Discriminants that rounding may have turned negative are tried, and every solution is polished by
//!   Newton steps on the two conics and must then meet the sides.

/// A symmetric 3x3 matrix: xx, xy, yy, x, y, 1; the quadratic `xx x² + 2 xy x y + yy y² + 2 x x + 2 y y + 1`.
type Conic = [f64; 6];

/// Sides that are met to this share of their sum are met.
const TOLERANCE: f64 = 1e-11;

/// A discriminant this far below zero, relative to its summands, may be rounding.
const DISCRIMINANT_SLACK: f64 = 1e-6;

/// Distances along the rays, with the sensitivity of their ratios.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Distances {
    pub along: [f64; 3],
    /// The condition number of the two conics at their meeting point; infinite where they touch.
    pub condition: f64,
}

/// Up to four solutions.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Found {
    pub items: [Distances; 4],
    pub count: usize,
}

/// Returns all positive distances for rays with `versines[k] = 1 - cos` of their angles and squared
/// sides, both in the order 12, 23, 31; the last side must be the longest.
pub(super) fn distances(versines: &[f64; 3], sides: &[f64; 3]) -> Found {
    let largest = versines[0].max(versines[1]).max(versines[2]);
    let scale = (2.0 * largest).sqrt();
    let (of_largest, of_total) = (1.0 / largest, 1.0 / (sides[0] + sides[1] + sides[2]));
    let k = [versines[0] * of_largest, versines[1] * of_largest, versines[2] * of_largest];
    let a = [sides[0] * of_total, sides[1] * of_total, sides[2] * of_total];
    // q12 = x² + k12 (1 + s x), and so on.
    let half = 0.5 * scale;
    let q12 = [1.0, 0.0, 0.0, k[0] * half, 0.0, k[0]];
    let q31 = [0.0, 0.0, 1.0, 0.0, k[2] * half, k[2]];
    let q23 = [1.0, -1.0 + k[1] * 2.0 * half * half, 1.0, k[1] * half, k[1] * half, k[1]];
    let first = combined(&q12, a[2], &q31, -a[0]);
    let second = combined(&q23, a[2], &q31, -a[1]);
    let mut found = Found::default();
    let Some((degenerate, other)) = degenerate_conic(&first, &second) else { return found };
    let Some(lines) = lines_of(&degenerate) else { return found };
    for line in &lines {
        let (points, count) = meeting_points(line, &other);
        for &point in &points[..count] {
            let Some((x, y, condition)) = polished(&first, &second, point) else { continue };
            // The three sides are s² d1² times these.
            let q = [value(&q12, x, y), value(&q23, x, y), value(&q31, x, y)];
            let sum = q[0] + q[1] + q[2];
            let most = TOLERANCE * sum;
            // NaN fails these, and so does a sum that is not positive.
            let is_met = (q[0] - a[0] * sum).abs() < most
                && (q[1] - a[1] * sum).abs() < most
                && (q[2] - a[2] * sum).abs() < most;
            let ratios = [1.0 + scale * x, 1.0 + scale * y];
            if is_met && ratios[0] > 0.0 && ratios[1] > 0.0 {
                let nearest = 1.0 / (scale * (sum * of_total).sqrt());
                let along = [nearest, nearest * ratios[0], nearest * ratios[1]];
                add(&mut found, Distances { along, condition });
            }
        }
    }
    found
}

fn add(found: &mut Found, new: Distances) {
    let is_known = found.items[..found.count].iter().any(|old| {
        let apart = (0..3).map(|i| (old.along[i] - new.along[i]).abs()).fold(0.0, f64::max);
        apart < 1e-11 * new.along[0].max(new.along[1]).max(new.along[2])
    });
    if !is_known && found.count < 4 {
        found.items[found.count] = new;
        found.count += 1;
    }
}

fn combined(one: &Conic, factor: f64, other: &Conic, other_factor: f64) -> Conic {
    let mut sum = [0.0; 6];
    for i in 0..6 {
        sum[i] = one[i] * factor + other[i] * other_factor;
    }
    sum
}

fn value(c: &Conic, x: f64, y: f64) -> f64 {
    x * (c[0] * x + 2.0 * (c[1] * y + c[3])) + y * (c[2] * y + 2.0 * c[4]) + c[5]
}

/// The adjugate, which is symmetric too, in the same order.
fn adjugate([xx, xy, yy, x, y, one]: &Conic) -> Conic {
    [
        yy * one - y * y,
        x * y - xy * one,
        xx * one - x * x,
        xy * y - x * yy,
        xy * x - xx * y,
        xx * yy - xy * xy,
    ]
}

fn determinant(c: &Conic, adjugate: &Conic) -> f64 {
    c[0] * adjugate[0] + c[1] * adjugate[1] + c[3] * adjugate[3]
}

/// The trace of the product of two symmetric matrices.
fn trace_of_product(a: &Conic, b: &Conic) -> f64 {
    a[0] * b[0] + a[2] * b[2] + a[5] * b[5] + 2.0 * (a[1] * b[1] + a[3] * b[3] + a[4] * b[4])
}

/// Returns the degenerate conic of the pencil whose root stands most apart, and another conic to meet its lines.
fn degenerate_conic(first: &Conic, second: &Conic) -> Option<(Conic, Conic)> {
    let (adjugate_1, adjugate_2) = (adjugate(first), adjugate(second));
    // det(α first + β second), by powers of β.
    let form = [
        determinant(first, &adjugate_1),
        trace_of_product(&adjugate_1, second),
        trace_of_product(&adjugate_2, first),
        determinant(second, &adjugate_2),
    ];
    // The leading conic must be far from degenerate; no root is then at infinity.
    let size = form[0].abs() + form[1].abs() + form[2].abs() + form[3].abs();
    let (leading, base, [c3, c2, c1, c0]) = if form[0].abs().max(form[3].abs()) < LEAST_LEAD * size {
        turned(first, second, &form)
    } else if form[3].abs() >= form[0].abs() {
        (*second, *first, [form[3], form[2], form[1], form[0]])
    } else {
        (*first, *second, form)
    };
    let of_c3 = 1.0 / c3;
    let gamma = isolated_root(c2 * of_c3, c1 * of_c3, c0 * of_c3)?;
    let degenerate = combined(&base, 1.0, &leading, gamma);
    Some((degenerate, if gamma.abs() <= 1.0 { leading } else { base }))
}

/// The least determinant of a leading conic, relative to all coefficients of the cubic.
const LEAST_LEAD: f64 = 0.05;

/// Returns two conics of a pencil both of whose own are nearly degenerate, of which the first is not, and the cubic
/// `det(γ leading + base)` by falling powers of γ.
#[cold]
fn turned(first: &Conic, second: &Conic, form: &[f64; 4]) -> (Conic, Conic, [f64; 4]) {
    const TURNS: [[f64; 2]; 4] = [[0.0, 1.0], [1.0, 0.0], [0.6, 0.8], [0.8, -0.6]];
    let at = |[a, b]: [f64; 2]| ((form[3] * b + form[2] * a) * b + form[1] * a * a) * b + form[0] * a * a * a;
    let mut lead = TURNS[0];
    for turn in &TURNS[1..] {
        if at(*turn).abs() > at(lead).abs() {
            lead = *turn;
        }
    }
    // (α, β) = base + γ lead, with base perpendicular to lead.
    let ([p, q], [m, n]) = (lead, [-lead[1], lead[0]]);
    let c2 = 3.0 * (form[0] * p * p * m + form[3] * q * q * n)
        + form[1] * (2.0 * p * m * q + p * p * n)
        + form[2] * (2.0 * q * n * p + q * q * m);
    let c1 = 3.0 * (form[0] * m * m * p + form[3] * n * n * q)
        + form[1] * (2.0 * p * m * n + m * m * q)
        + form[2] * (2.0 * q * n * m + n * n * p);
    (combined(first, p, second, q), combined(first, m, second, n), [at(lead), c2, c1, at([m, n])])
}

/// The polynomial of degree five that is nearest to 2 cos(acos(h) / 3) between 0 and 1: it is right to 1e-6.
const VIETE: [f64; 6] =
    [1.732051826, 0.3332520433, -0.09516250507, 0.04411014884, -0.01828489552, 0.004034400866];

/// Returns the real root of `t³ + b t² + c t + d` that stands most apart from the others.
fn isolated_root(b: f64, c: f64, d: f64) -> Option<f64> {
    let shift = b / 3.0;
    // Of t³ + p t + q, whose roots sum to zero, it is the largest in size.
    let p = c - b * shift;
    let q = d - c * shift + 2.0 * shift * shift * shift;
    let (half, third) = (0.5 * q.abs(), p / 3.0);
    let discriminant = half * half + third * third * third;
    let size = if discriminant >= 0.0 {
        let cube = half + discriminant.sqrt();
        if cube > LEAST_CUBE {
            let u = cube_root_nearby(cube);
            u - third / u
        } else {
            0.0
        }
    } else {
        // Viète's 2 cos(acos(h) / 3), which the steps below mend.
        let root = (-third).sqrt();
        let h = (half / (root * root * root)).min(1.0);
        let square = h * h;
        let [low, middle, high] = [0, 2, 4].map(|i| VIETE[i] + VIETE[i + 1] * h);
        root * (low + square * (middle + square * high))
    };
    let mut t = if q > 0.0 { -size } else { size } - shift;
    for _ in 0..2 {
        let value = ((t + b) * t + c) * t + d;
        let slope = (3.0 * t + 2.0 * b) * t + c;
        if slope != 0.0 {
            t -= value / slope;
        }
    }
    t.is_finite().then_some(t)
}

/// Roots of a smaller cube are zero.
const LEAST_CUBE: f64 = 1e-150;

/// Returns the cube root of a positive number to 1e-4: an exponent divided by three, and a step of Halley's.
fn cube_root_nearby(cube: f64) -> f64 {
    // Two thirds of the exponent's offset, less what makes the largest error least.
    const OFFSET: u64 = 0x2a9f_7893_782d_a1ce;
    let root = f64::from_bits(cube.to_bits() / 3 + OFFSET);
    let third_power = root * root * root;
    root * (third_power + 2.0 * cube) / (2.0 * third_power + cube)
}

/// Returns the two lines of a degenerate conic: section 11.1 of Richter-Gebert 2011.
fn lines_of(conic: &Conic) -> Option<[[f64; 3]; 2]> {
    let [xx, xy, yy, x, y, one] = *conic;
    let adjugate = adjugate(conic);
    let [a, b, c, d, e, f] = adjugate;
    // The lines meet at the vertex, whose outer product with itself is minus the adjugate.
    let (square, vertex) = if -a >= -c && -a >= -f {
        (-a, [-a, -b, -d])
    } else if -c >= -f {
        (-c, [-b, -c, -e])
    } else {
        (-f, [-d, -e, -f])
    };
    // Of a double line nothing is left.
    let inverse = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
    let (p, q, r) = (vertex[0] * inverse, vertex[1] * inverse, vertex[2] * inverse);
    // The product of the two lines: its longest row and column are they.
    let product = [[xx, xy - r, x + q], [xy + r, yy, y - p], [x - q, y + p, one]];
    let (mut of_row, mut of_column) = ([0.0; 3], [0.0; 3]);
    for i in 0..3 {
        for j in 0..3 {
            let square = product[i][j] * product[i][j];
            of_row[i] += square;
            of_column[j] += square;
        }
    }
    let (i, j) = (index_of_largest(&of_row), index_of_largest(&of_column));
    (of_row[i] > 0.0).then(|| [product[i], [product[0][j], product[1][j], product[2][j]]])
}

fn index_of_largest(numbers: &[f64; 3]) -> usize {
    let i = usize::from(numbers[1] > numbers[0]);
    if numbers[2] > numbers[i] { 2 } else { i }
}

/// Returns where a line meets a conic, and in how many points.
fn meeting_points(line: &[f64; 3], c: &Conic) -> ([[f64; 2]; 2], usize) {
    const NOWHERE: ([[f64; 2]; 2], usize) = ([[0.0; 2]; 2], 0);
    let [l, m, n] = *line;
    let swapped = l.abs() > m.abs();
    let (l, m) = if swapped { (m, l) } else { (l, m) };
    if m == 0.0 {
        return NOWHERE;
    }
    let inverse = -1.0 / m;
    let (slope, intercept) = (l * inverse, n * inverse);
    // The conic with the line's second coordinate put in: a t² + 2 b t + e.
    let (c_tt, c_ww, c_t, c_w) = if swapped { (c[2], c[0], c[4], c[3]) } else { (c[0], c[2], c[3], c[4]) };
    let a = c_tt + slope * (2.0 * c[1] + slope * c_ww);
    let b = c[1] * intercept + c_t + slope * (c_ww * intercept + c_w);
    let e = intercept * (c_ww * intercept + 2.0 * c_w) + c[5];
    let discriminant = b * b - a * e;
    let size = b * b + (a * e).abs();
    let is_usable = size > 0.0 && discriminant >= -DISCRIMINANT_SLACK * size;
    if !is_usable {
        return NOWHERE;
    }
    // Of a discriminant just below zero the root of its size is as good a start as any.
    let root = discriminant.abs().sqrt();
    let larger = if b > 0.0 { -b - root } else { -b + root };
    let mut meeting = NOWHERE;
    if a != 0.0 {
        let t = larger / a;
        meeting.0[0] = [t, slope * t + intercept];
        meeting.1 = 1;
    }
    if larger != 0.0 {
        let t = e / larger;
        meeting.0[meeting.1] = [t, slope * t + intercept];
        meeting.1 += 1;
    }
    if swapped {
        for point in &mut meeting.0 {
            point.swap(0, 1);
        }
    }
    meeting
}

/// Returns the point where both conics vanish, from a start nearby, and the condition number there.
fn polished(first: &Conic, second: &Conic, [mut x, mut y]: [f64; 2]) -> Option<(f64, f64, f64)> {
    const MAX_STEPS: usize = 30;
    let mut last_step = f64::INFINITY;
    let mut condition = f64::INFINITY;
    for _ in 0..MAX_STEPS {
        let gradient = |c: &Conic| [c[0] * x + c[1] * y + c[3], c[1] * x + c[2] * y + c[4]];
        let ([a, b], [c, d]) = (gradient(first), gradient(second));
        let determinant = a * d - b * c;
        if determinant == 0.0 {
            condition = f64::INFINITY;
            break;
        }
        let inverse = 1.0 / determinant;
        condition = (a * a + b * b + c * c + d * d) * inverse.abs();
        // The gradients are half the derivatives.
        let (f, g) = (0.5 * value(first, x, y), 0.5 * value(second, x, y));
        let (dx, dy) = ((f * d - g * b) * inverse, (g * a - f * c) * inverse);
        let step = dx.abs() + dy.abs();
        let reach = 1.0 + x.abs() + y.abs();
        // Steps that no longer shrink are rounding, unless they are still long.
        if step >= last_step && step < 1e-6 * reach {
            break;
        }
        (x, y) = (x - dx, y - dy);
        // The error that is left is of the order of the square of the step, or this is no number.
        let is_short = step * step * condition < 1e-17 * reach;
        if is_short || !step.is_finite() {
            break;
        }
        last_step = step;
    }
    (x.is_finite() && y.is_finite()).then_some((x, y, condition))
}
