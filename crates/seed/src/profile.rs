//! The lens profile and the depths of all views, from the radial poses of one camera, by linear least squares.
//!
//! A point `(x, y, z)` in the camera's frame with `rho = hypot(x, y)`, seen at `r` pixels from the
//! centre, satisfies `r z = rho g(r)`, where `g(r) = r / tan(theta)` is the profile of the lens: the
//! focal length of a pinhole, and for any smooth radially symmetric lens an even function,
//! `g = a0 + a2 r² + a4 r⁴ + ...` (eq. 6 of Scaramuzza, Martinelli & Siegwart 2006; the odd terms
//! vanish by symmetry). It passes through zero at 90 degrees, where a focal length would be infinite.
//! With the rotations known, the equation is linear in the coefficients and each view's depth.

use boresight_geometry::nalgebra::{Cholesky, DMatrix, DVector};

use crate::linear::exceeds;
use crate::radial::{RadialPose, length};
use crate::robust::{cauchy_weight, median, width_for};
use crate::sighting::Sighting;

/// The largest number of coefficients; `r⁶` follows lenses to beyond 100 degrees off axis.
const MAX_TERMS: usize = 4;

/// A radially symmetric lens without a formula: `r / tan(theta) = g(r)`.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    /// Coefficients of `1, s², s⁴, ...` with `s = r / radius_px`, in pixels.
    pub coefficients_px: Vec<f64>,
    /// The largest radius at which the lens was seen.
    pub radius_px: f64,
}

impl Profile {
    /// Returns `g` at radius `r`, in pixels.
    pub fn at(&self, r: f64) -> f64 {
        let square = (r / self.radius_px).powi(2);
        self.coefficients_px.iter().rev().fold(0.0, |sum, coefficient| sum * square + coefficient)
    }

    /// Returns the angle off axis, in radians, that is seen at radius `r`.
    pub fn angle_at(&self, r: f64) -> f64 {
        r.atan2(self.at(r))
    }

    /// Tells whether the angle grows with the radius as far as the lens was seen.
    fn is_monotonic(&self) -> bool {
        const STEPS: usize = 40;
        let angle = |i: usize| self.angle_at(self.radius_px * i as f64 / STEPS as f64);
        self.coefficients_px[0] > 0.0 && (0..STEPS).all(|i| angle(i + 1) > angle(i))
    }
}

/// One view as the profile sees it: for each point `r`, `rho` and the height over the centroid's plane.
pub(crate) struct ProfileView {
    rows: Vec<[f64; 3]>,
    /// The trust in each row from its direction, and the weight from its radius on top.
    trust: Vec<f64>,
    row_weights: Vec<f64>,
    /// Whether the tilt's sign is open.
    is_planar: bool,
    pub is_mirrored: bool,
    /// The depth of the centroid, in metres.
    pub depth: f64,
    weight: f64,
}

impl ProfileView {
    /// Returns the view's points as radius, distance off axis and height, from its radial pose.
    pub fn new(sighting: &Sighting, radial: &RadialPose, centre: [f64; 2]) -> Self {
        let rows = sighting.points.iter().zip(&sighting.pixels).map(|(point, pixel)| {
            let offset = radial.rotation * (point - sighting.centroid);
            let rho = length(offset.x + radial.centroid_xy[0], offset.y + radial.centroid_xy[1]);
            [length(pixel[0] - centre[0], pixel[1] - centre[1]), rho, offset.z]
        });
        Self {
            rows: rows.collect(),
            trust: radial.trust.clone(),
            row_weights: radial.trust.clone(),
            is_planar: radial.mirrored.is_some(),
            is_mirrored: false,
            depth: 0.0,
            weight: 1.0,
        }
    }

    fn sign(&self) -> f64 {
        if self.is_mirrored { -1.0 } else { 1.0 }
    }

    /// Finds the depth that suits a known profile best, and the sign of the tilt; returns the robust residual in pixels.
    pub fn place(&mut self, profile: &Profile) -> f64 {
        let mut best = (f64::INFINITY, self.is_mirrored, self.depth);
        let signs: &[bool] = if self.is_planar { &[false, true] } else { &[self.is_mirrored] };
        for &is_mirrored in signs {
            self.is_mirrored = is_mirrored;
            self.depth = self.median_depth(profile);
            let residual = self.residual_px(profile);
            if residual < best.0 {
                best = (residual, is_mirrored, self.depth);
            }
        }
        (self.is_mirrored, self.depth) = (best.1, best.2);
        best.0
    }

    /// Returns the weighted median over the points of the depth that each asks for.
    fn median_depth(&self, profile: &Profile) -> f64 {
        // Each point asks for rho g / r; a point near the centre of the image says little, so the
        // median is over the outer half.
        let typical = median(&self.rows.iter().map(|row| row[0]).collect::<Vec<_>>());
        let asked = self.rows.iter().filter(|row| row[0] >= typical && row[0] > 0.0);
        let depths: Vec<f64> =
            asked.map(|[r, rho, height]| rho * profile.at(*r) / r - self.sign() * height).collect();
        median(&depths)
    }

    /// Returns the residual of one row in pixels of radius.
    fn row_residual_px(&self, [r, rho, height]: [f64; 3], profile: &Profile) -> f64 {
        let z = self.sign() * height + self.depth;
        (r * z - rho * profile.at(r)) / length(rho, z).max(f64::MIN_POSITIVE)
    }

    fn residual_px(&self, profile: &Profile) -> f64 {
        let residuals: Vec<f64> =
            self.rows.iter().map(|&row| self.row_residual_px(row, profile).abs()).collect();
        // The mean of what is not an outlier separates the signs better than a median would.
        let width = width_for(median(&residuals));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (residual, trust) in residuals.into_iter().zip(&self.trust) {
            let weight = trust * cauchy_weight(residual, width);
            sum += weight * residual * residual;
            weights += weight;
        }
        (sum / weights).sqrt()
    }
}

/// Returns the profile that suits all views, which get their depths and signs, or `None` if the
/// views determine none. The image is `extent_px` wide; directions are good to `noise_px`.
pub(crate) fn fit_profile(views: &mut [ProfileView], extent_px: f64, noise_px: f64) -> Option<Profile> {
    let radius_px = views.iter().flat_map(|view| &view.rows).map(|row| row[0]).fold(0.0, f64::max);
    if !exceeds(radius_px, 0.0) {
        return None;
    }
    // The signs are the one thing that is not linear. They are guessed from each view alone, then
    // with lenses of several widths, until the joint fit is nearly as good as the directions are.
    let mut best: Option<(f64, Vec<(bool, f64)>)> = None;
    for guess in std::iter::once(None).chain(guesses(extent_px, radius_px).into_iter().map(Some)) {
        guess_signs(views, guess.as_ref(), extent_px, radius_px);
        let Some(residual_px) = settle_signs(views, radius_px) else { continue };
        // Two starts that agree on all signs are as good as a small residual.
        let agrees = |found: &(f64, Vec<(bool, f64)>)| {
            found.1.iter().zip(views.iter()).all(|((is_mirrored, _), view)| *is_mirrored == view.is_mirrored)
        };
        let is_settled = residual_px < 4.0 * noise_px || best.as_ref().is_some_and(agrees);
        if best.as_ref().is_none_or(|(lowest, _)| residual_px < *lowest) {
            best = Some((residual_px, views.iter().map(|view| (view.is_mirrored, view.depth)).collect()));
        }
        if is_settled {
            break;
        }
    }
    for (view, (is_mirrored, depth)) in views.iter_mut().zip(best?.1) {
        (view.is_mirrored, view.depth) = (is_mirrored, depth);
        view.row_weights.clone_from(&view.trust);
        view.weight = 1.0;
    }
    let first = solve(views, 3, radius_px).or_else(|| solve(views, 1, radius_px))?;
    reweigh(views, &first);
    let profile = choose_terms(views, radius_px)?;
    for view in views.iter_mut() {
        view.place(&profile);
    }
    Some(profile)
}

/// Returns pinholes and equidistant lenses of several widths.
fn guesses(extent_px: f64, radius_px: f64) -> Vec<Profile> {
    // theta cot(theta) = 1 - theta²/3 - theta⁴/45 - 2 theta⁶/945 - ...
    let equidistant = |edge_rad: f64| {
        let (focal_px, square) = (radius_px / edge_rad, edge_rad * edge_rad);
        let series = [1.0, -square / 3.0, -square.powi(2) / 45.0, -2.0 * square.powi(3) / 945.0];
        Profile { coefficients_px: series.map(|term| focal_px * term).to_vec(), radius_px }
    };
    let pinhole = |share: f64| Profile { coefficients_px: vec![share * extent_px], radius_px };
    vec![equidistant(1.2), equidistant(1.6), pinhole(0.8), pinhole(2.5), equidistant(0.8), pinhole(8.0)]
}

/// Sets signs and depths from a guess of the lens, or from each view alone.
fn guess_signs(views: &mut [ProfileView], guess: Option<&Profile>, extent_px: f64, radius_px: f64) {
    for view in views.iter_mut() {
        view.row_weights.clone_from(&view.trust);
        (view.weight, view.is_mirrored) = (1.0, false);
        if let Some(guess) = guess {
            view.place(guess);
            continue;
        }
        let start = Profile { coefficients_px: vec![extent_px], radius_px };
        view.depth = view.median_depth(&start).abs();
        // Alone, a view says which sign makes the focal length positive.
        if let Some(alone) = solve(std::slice::from_mut(view), 1, radius_px)
            && alone.coefficients_px[0] < 0.0
            && view.is_planar
        {
            view.is_mirrored = true;
            view.depth = -view.depth;
        }
    }
}

/// Fits the profile and chooses the signs in turn until they stay; returns the residual in pixels.
fn settle_signs(views: &mut [ProfileView], radius_px: f64) -> Option<f64> {
    let mut residual_px = None;
    for _ in 0..6 {
        let mut found = [3, 2, 1].into_iter().find_map(|terms| solve(views, terms, radius_px))?;
        if found.at(0.3 * radius_px) < 0.0 {
            // All signs at once are a matter of convention.
            found.coefficients_px.iter_mut().for_each(|coefficient| *coefficient = -*coefficient);
        }
        let before: Vec<bool> = views.iter().map(|view| view.is_mirrored).collect();
        let residuals = reweigh(views, &found);
        residual_px = Some(residuals.iter().sum::<f64>() / residuals.len() as f64);
        if views.iter().zip(before).all(|(view, before)| view.is_mirrored == before) {
            break;
        }
    }
    residual_px
}

/// Places all views on a profile and weighs them by how well they fit; returns their residuals in pixels.
fn reweigh(views: &mut [ProfileView], profile: &Profile) -> Vec<f64> {
    let residuals: Vec<f64> = views.iter_mut().map(|view| view.place(profile)).collect();
    let width = width_for(median(&residuals)).max(1e-3);
    for (view, residual) in views.iter_mut().zip(&residuals) {
        view.weight = cauchy_weight(*residual, width);
        for i in 0..view.rows.len() {
            let residual = view.row_residual_px(view.rows[i], profile);
            view.row_weights[i] = view.trust[i] * cauchy_weight(residual, 3.0 * width);
        }
    }
    residuals
}

/// Returns the profile with as many terms as the data ask for: one more must lower the squared residual by a tenth.
fn choose_terms(views: &mut [ProfileView], radius_px: f64) -> Option<Profile> {
    let mut best: Option<(f64, Profile)> = None;
    for terms in 1..=MAX_TERMS {
        let mut found = None;
        for _ in 0..2 {
            found = solve(views, terms, radius_px);
        }
        let Some(profile) = found.filter(Profile::is_monotonic) else { continue };
        let cost: f64 = views.iter().map(|view| view.weight * view.residual_px(&profile).powi(2)).sum();
        if best.as_ref().is_none_or(|(lowest, _)| cost < 0.9 * lowest) {
            best = Some((cost, profile));
        }
    }
    best.map(|(_, profile)| profile)
}

/// Solves for `terms` coefficients and all depths at the present signs, weighing rows by the present
/// depths, and sets the depths.
fn solve(views: &mut [ProfileView], terms: usize, radius_px: f64) -> Option<Profile> {
    let mut normal = DMatrix::<f64>::zeros(terms, terms);
    let mut right = DVector::<f64>::zeros(terms);
    let mut eliminated = Vec::with_capacity(views.len());
    for view in views.iter() {
        // Per view the depth's row and column: c depth - b·a = t, eliminated by a Schur complement.
        let (mut c, mut t, mut b) = (0.0, 0.0, [0.0; MAX_TERMS]);
        let sign = view.sign();
        for (&[r, rho, height], row_weight) in view.rows.iter().zip(&view.row_weights) {
            let z = sign * height + view.depth;
            let weight = view.weight * row_weight / (rho * rho + z * z).max(f64::MIN_POSITIVE);
            let square = (r / radius_px).powi(2);
            let mut powers = [0.0; MAX_TERMS];
            powers[0] = rho;
            for k in 1..terms {
                powers[k] = powers[k - 1] * square;
            }
            let (wr, known) = (weight * r, r * sign * height);
            c += wr * r;
            t -= wr * known;
            for k in 0..terms {
                b[k] += wr * powers[k];
                right[k] += weight * powers[k] * known;
                for j in 0..=k {
                    normal[(k, j)] += weight * powers[k] * powers[j];
                }
            }
        }
        if !exceeds(c, 0.0) {
            return None;
        }
        for k in 0..terms {
            right[k] += b[k] * t / c;
            for j in 0..=k {
                normal[(k, j)] -= b[k] * b[j] / c;
            }
        }
        eliminated.push((c, t, b));
    }
    normal.fill_upper_triangle_with_lower_triangle();
    // Scaled to a unit diagonal, so that singular means singular whatever the units.
    let scale = DVector::from_fn(terms, |k, _| normal[(k, k)].max(0.0).sqrt());
    if scale.iter().any(|value| !exceeds(*value, 0.0)) {
        return None;
    }
    for k in 0..terms {
        for j in 0..terms {
            normal[(k, j)] /= scale[k] * scale[j];
        }
        normal[(k, k)] += 1e-12;
        right[k] /= scale[k];
    }
    let solution = Cholesky::new(normal)?.solve(&right);
    let coefficients_px: Vec<f64> = (0..terms).map(|k| solution[k] / scale[k]).collect();
    if coefficients_px.iter().any(|value| !value.is_finite()) {
        return None;
    }
    for (view, (c, t, b)) in views.iter_mut().zip(eliminated) {
        view.depth = (t + coefficients_px.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()) / c;
    }
    Some(Profile { coefficients_px, radius_px })
}
