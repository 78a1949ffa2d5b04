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
pub(super) fn distances(versines: [f64; 3], sides: [f64; 3]) -> Found {
    let largest = versines[0].max(versines[1]).max(versines[2]);
    let scale = (2.0 * largest).sqrt();
    let k = [versines[0] / largest, versines[1] / largest, versines[2] / largest];
    let total = sides[0] + sides[1] + sides[2];
    let a = [sides[0] / total, sides[1] / total, sides[2] / total];
    // q12 = x² + k12 (1 + s x), and so on.
    let half = 0.5 * scale;
    let q12 = [1.0, 0.0, 0.0, k[0] * half, 0.0, k[0]];
    let q31 = [0.0, 0.0, 1.0, 0.0, k[2] * half, k[2]];
    let q23 = [1.0, -1.0 + k[1] * 2.0 * half * half, 1.0, k[1] * half, k[1] * half, k[1]];
    let first = combined(q12, a[2], q31, -a[0]);
    let second = combined(q23, a[2], q31, -a[1]);
    let mut found = Found::default();
    let Some((degenerate, other)) = degenerate_conic(&first, &second) else { return found };
    for line in lines_of(&degenerate).into_iter().flatten() {
        for point in meeting_points(&line, &other).into_iter().flatten() {
            if let Some((x, y, condition)) = polished(&first, &second, point) {
                // The three sides are s² d1² times these.
                let q = [value(&q12, x, y), value(&q23, x, y), value(&q31, x, y)];
                let sum = q[0] + q[1] + q[2];
                let inverse = 1.0 / sum;
                let misfit = [0, 1, 2].map(|k: usize| (q[k] * inverse - a[k]).abs());
                let misfit = misfit[0].max(misfit[1]).max(misfit[2]);
                let nearest = (total * inverse).sqrt() / scale;
                let along = [nearest, nearest * (1.0 + scale * x), nearest * (1.0 + scale * y)];
                // NaN fails these as well.
                let is_met = sum > 0.0 && misfit < TOLERANCE && along[1] > 0.0 && along[2] > 0.0;
                if is_met {
                    add(&mut found, Distances { along, condition });
                }
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

fn combined(one: Conic, factor: f64, other: Conic, other_factor: f64) -> Conic {
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
    // The pencil is turned so that the leading conic is far from degenerate; no root is then at infinity.
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
    let c3 = at(lead);
    let c2 = 3.0 * (form[0] * p * p * m + form[3] * q * q * n)
        + form[1] * (2.0 * p * m * q + p * p * n)
        + form[2] * (2.0 * q * n * p + q * q * m);
    let c1 = 3.0 * (form[0] * m * m * p + form[3] * n * n * q)
        + form[1] * (2.0 * p * m * n + m * m * q)
        + form[2] * (2.0 * q * n * m + n * n * p);
    let c0 = at([m, n]);
    let gamma = isolated_root(c2 / c3, c1 / c3, c0 / c3)?;
    let leading = combined(*first, p, *second, q);
    let base = combined(*first, m, *second, n);
    let degenerate = combined(base, 1.0, leading, gamma);
    Some((degenerate, if gamma.abs() <= 1.0 { leading } else { base }))
}

/// The cubic that has the value of 2 cos(acos(h) / 3) at 0, 1/2 and 1, and its slope at 0.
const VIETE: [f64; 4] = [1.7320508075688772, 0.3333333333333333, -0.089274275, 0.023890134];

/// Returns the real root of `t³ + b t² + c t + d` that stands most apart from the others.
fn isolated_root(b: f64, c: f64, d: f64) -> Option<f64> {
    let shift = b / 3.0;
    // Of t³ + p t + q, whose roots sum to zero, it is the largest in size.
    let p = c - b * shift;
    let q = d - c * shift + 2.0 * shift * shift * shift;
    let (half, third) = (0.5 * q.abs(), p / 3.0);
    let discriminant = half * half + third * third * third;
    let size = if discriminant >= 0.0 {
        let u = (half + discriminant.sqrt()).cbrt();
        if u > 0.0 { u - third / u } else { 0.0 }
    } else {
        // Viète's 2 cos(acos(h) / 3) by a cubic that is right to 3e-4, which the steps below mend.
        let root = (-third).sqrt();
        let h = (half / (root * root * root)).min(1.0);
        root * (VIETE[0] + h * (VIETE[1] + h * (VIETE[2] + h * VIETE[3])))
    };
    let mut t = if q > 0.0 { -size } else { size } - shift;
    for _ in 0..3 {
        let value = ((t + b) * t + c) * t + d;
        let slope = (3.0 * t + 2.0 * b) * t + c;
        if slope != 0.0 {
            t -= value / slope;
        }
    }
    t.is_finite().then_some(t)
}

/// Returns the two lines of a degenerate conic: section 11.1 of Richter-Gebert 2011.
fn lines_of(conic: &Conic) -> [Option<[f64; 3]>; 2] {
    let [xx, xy, yy, x, y, one] = *conic;
    let adjugate = adjugate(conic);
    let [a, b, c, d, e, f] = adjugate;
    // The lines meet at the vertex, whose outer product with itself is minus the adjugate.
    let (square, mut vertex) = if -a >= -c && -a >= -f {
        (-a, [-a, -b, -d])
    } else if -c >= -f {
        (-c, [-b, -c, -e])
    } else {
        (-f, [-d, -e, -f])
    };
    let size = square.max(0.0).sqrt();
    if size > 0.0 {
        for coordinate in &mut vertex {
            *coordinate /= size;
        }
    } else {
        // A double line.
        vertex = [0.0; 3];
    }
    let [p, q, r] = vertex;
    let product = [[xx, xy - r, x + q], [xy + r, yy, y - p], [x - q, y + p, one]];
    let mut largest = (0, 0);
    for i in 0..3 {
        for j in 0..3 {
            if product[i][j].abs() > product[largest.0][largest.1].abs() {
                largest = (i, j);
            }
        }
    }
    let (i, j) = largest;
    let row = product[i];
    let column = [product[0][j], product[1][j], product[2][j]];
    if row[j] == 0.0 { [None, None] } else { [Some(row), Some(column)] }
}

/// Returns where a line meets a conic.
fn meeting_points(line: &[f64; 3], c: &Conic) -> [Option<[f64; 2]>; 2] {
    let [l, m, n] = *line;
    let swapped = l.abs() > m.abs();
    let (l, m) = if swapped { (m, l) } else { (l, m) };
    if m == 0.0 {
        return [None, None];
    }
    let (slope, intercept) = (-l / m, -n / m);
    // The conic with the line's second coordinate put in: a t² + 2 b t + e.
    let (c_tt, c_ww, c_t, c_w) = if swapped { (c[2], c[0], c[4], c[3]) } else { (c[0], c[2], c[3], c[4]) };
    let a = c_tt + slope * (2.0 * c[1] + slope * c_ww);
    let b = c[1] * intercept + c_t + slope * (c_ww * intercept + c_w);
    let e = intercept * (c_ww * intercept + 2.0 * c_w) + c[5];
    let discriminant = b * b - a * e;
    let size = b * b + (a * e).abs();
    let is_usable = size > 0.0 && discriminant >= -DISCRIMINANT_SLACK * size;
    if !is_usable {
        return [None, None];
    }
    // Of a discriminant just below zero the root of its size is as good a start as any.
    let root = discriminant.abs().sqrt();
    let larger = if b > 0.0 { -b - root } else { -b + root };
    let roots =
        [if a == 0.0 { None } else { Some(larger / a) }, if larger == 0.0 { None } else { Some(e / larger) }];
    let back = |t: f64| {
        let w = slope * t + intercept;
        if swapped { [w, t] } else { [t, w] }
    };
    [roots[0].map(back), roots[1].map(back)]
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
