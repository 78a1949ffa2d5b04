//! Terms made from functions, a check of any term against differences, and dense references.

use boresight_geometry::{Matrix3, Pose, Vector3, skew};
use boresight_solver::{
    BlockId, Counters, Elimination, GramMut, Parameters, Problem, Scratch, Solution, SolveOptions, Term,
    TermKind, Values, solve,
};
use faer::Mat;
use faer::linalg::solvers::DenseSolveCore as _;

/// The rows `[J r]` of a function at some values, or `None` where it is not defined.
pub type Rows = Option<Vec<Vec<f64>>>;

/// Computes residuals only.
pub type Residuals<'a> = &'a dyn Fn(Values<'_>) -> Vec<f64>;

/// A term that is a function of its blocks.
pub struct Function<F> {
    blocks: Vec<BlockId>,
    n_rows: usize,
    rows: F,
}

impl<F: Fn(Values<'_>) -> Rows + Send + Sync> Function<F> {
    pub fn new(blocks: &[BlockId], n_rows: usize, rows: F) -> Self {
        Self { blocks: blocks.to_vec(), n_rows, rows }
    }
}

impl<F: Fn(Values<'_>) -> Rows + Send + Sync> Term for Function<F> {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn kind(&self) -> TermKind {
        TermKind::Observation
    }

    fn row_count(&self) -> usize {
        self.n_rows
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, _: &mut Scratch) -> Option<f64> {
        gram.clear();
        let mut cost = 0.0;
        for row in (self.rows)(values)? {
            let n = gram.size();
            assert_eq!(row.len(), n, "a row is as wide as its term");
            for a in 0..n {
                for b in a..n {
                    gram.add(a, b, row[a] * row[b]);
                }
            }
            cost += row[n - 1] * row[n - 1];
        }
        Some(cost)
    }
}

/// Solves with the defaults.
pub fn solve_plainly(parameters: &Parameters, terms: &[&dyn Term]) -> Solution {
    let problem = Problem::new(parameters, terms.to_vec()).expect("the problem is sound");
    solve(&problem, &SolveOptions::default()).expect("the problem can be solved")
}

/// Returns counters, for comparison with what a search counted.
pub fn counters(
    iterations: usize,
    evaluations: usize,
    factorizations: usize,
    rejected_steps: usize,
) -> Counters {
    Counters { iterations, evaluations, factorizations, rejected_steps }
}

/// Returns the derivative of `f` at zero by sixth-order central differences over `step`.
///
/// The truncation is of the order of `step`⁶ and the rounding that of 1e-16 / `step`.
pub fn derivative(step: f64, f: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let weights = [(1.0, 45.0), (2.0, -9.0), (3.0, 1.0)];
    let mut sum = vec![0.0; f(0.0).len()];
    for (multiple, weight) in weights {
        let (ahead, behind) = (f(multiple * step), f(-multiple * step));
        for (sum, (ahead, behind)) in sum.iter_mut().zip(ahead.iter().zip(&behind)) {
            *sum += weight * (ahead - behind) / (60.0 * step);
        }
    }
    sum
}

/// Returns the values reached from the first ones by `distance` along one tangent column.
pub fn moved(parameters: &Parameters, column: usize, distance: f64) -> Vec<f64> {
    let n_columns = parameters.column_count();
    let mut step = vec![0.0; n_columns];
    step[column] = distance;
    let mut moved = Vec::new();
    parameters.retract(parameters.values().as_slice(), &step, &mut moved);
    moved
}

/// Returns a term's Gram matrix (both triangles) and cost at `values`.
pub fn gram_of(term: &dyn Term, parameters: &Parameters, values: &[f64]) -> Option<(Mat<f64>, f64)> {
    let n = term.blocks().iter().map(|&block| parameters.columns(block).len()).sum::<usize>() + 1;
    // What a term finds there is of another term; it must not shine through.
    let mut entries = vec![f64::NAN; n * n];
    let cost =
        term.linearize(parameters.at(values), &mut GramMut::new(&mut entries, n), &mut Scratch::default())?;
    Some((Mat::from_fn(n, n, |a, b| entries[a.min(b) * n + a.max(b)]), cost))
}

/// Checks what any term reports at the first values: its gradient is half that of its cost, its
/// matrix is a Gram matrix, and evaluating it twice gives the same bits, whatever lay there before. With `residuals`, the
/// whole matrix is also held against their differences.
///
/// `step` is that of the differences, `tolerance` is relative to the largest entry compared.
pub fn check_term(
    parameters: &Parameters,
    term: &dyn Term,
    residuals: Option<Residuals<'_>>,
    step: f64,
    tolerance: f64,
) {
    let values = parameters.values().as_slice();
    let (gram, cost) = gram_of(term, parameters, values).expect("the term is defined");
    let (again, cost_again) = gram_of(term, parameters, values).expect("the term is defined");
    assert!(again == gram && cost_again.to_bits() == cost.to_bits(), "evaluating twice gives two answers");
    let n = gram.nrows() - 1;
    let close = |what: &str, found: f64, expected: f64, scale: f64| {
        assert!((found - expected).abs() <= tolerance * scale, "{what}: {found:e} against {expected:e}");
    };
    let columns: Vec<usize> = term.blocks().iter().flat_map(|&block| parameters.columns(block)).collect();
    let along = |k: usize, distance: f64| moved(parameters, columns[k], distance);
    let gradient: Vec<f64> = (0..n)
        .map(|k| {
            derivative(step, |d| vec![gram_of(term, parameters, &along(k, d)).expect("defined nearby").1])[0]
                / 2.0
        })
        .collect();
    // The gradient is a difference of costs, so its rounding is that of the cost.
    let scale = gradient.iter().fold(cost, |largest, g| largest.max(g.abs()));
    for k in 0..n {
        close(&format!("gradient {k}"), gram[(k, n)], gradient[k], scale);
    }
    for a in 0..=n {
        for b in 0..=n {
            let bound = gram[(a, a)] * gram[(b, b)] * (1.0 + 1e-12);
            assert!(gram[(a, b)] * gram[(a, b)] <= bound, "({a}, {b}) is no product of columns");
        }
    }
    let Some(residuals) = residuals else { return };
    let mut jacobian: Vec<Vec<f64>> =
        (0..n).map(|k| derivative(step, |d| residuals(parameters.at(&along(k, d))))).collect();
    jacobian.push(residuals(parameters.values()));
    let expected = |a: usize, b: usize| jacobian[a].iter().zip(&jacobian[b]).map(|(x, y)| x * y).sum::<f64>();
    let scale = (0..=n).map(|k| expected(k, k)).fold(0.0, f64::max);
    close("cost", cost, expected(n, n), scale);
    for a in 0..=n {
        for b in a..=n {
            close(&format!("entry ({a}, {b})"), gram[(a, b)], expected(a, b), scale);
        }
    }
}

/// Returns the inverse of the dense JᵀJ over all free columns, with zeros for those held, where J is
/// formed by differences of `residuals` over `step` at the parameters' first values.
pub fn dense_covariance(
    parameters: &Parameters,
    blocks: &[BlockId],
    residuals: impl Fn(Values<'_>) -> Vec<f64>,
    step: f64,
) -> Mat<f64> {
    let n_columns = parameters.column_count();
    let free: Vec<usize> = blocks
        .iter()
        .flat_map(|&block| {
            parameters.columns(block).enumerate().filter(move |&(k, _)| !parameters.is_held(block, k))
        })
        .map(|(_, column)| column)
        .collect();
    let column =
        |&column: &usize| derivative(step, |d| residuals(parameters.at(&moved(parameters, column, d))));
    let jacobian: Vec<Vec<f64>> = free.iter().map(column).collect();
    let jacobian = Mat::from_fn(jacobian[0].len(), free.len(), |row, column| jacobian[column][row]);
    let inverse = (jacobian.transpose() * &jacobian).partial_piv_lu().inverse();
    let mut covariance = Mat::zeros(n_columns, n_columns);
    for (a, &row) in free.iter().enumerate() {
        for (b, &column) in free.iter().enumerate() {
            covariance[(row, column)] = inverse[(a, b)];
        }
    }
    covariance
}

/// Numbers that look random and are the same everywhere.
pub struct Numbers(u64);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    /// Returns the next number, uniform in [-1, 1): SplitMix64 of Steele, Lea & Flood 2014.
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / 2f64.powi(63) - 1.0
    }
}

/// Point clouds that sensors see of poses: each point is measured after a shared 3x3 upper triangular
/// distortion `I + a`, in every view from another pose.
///
/// The vectors are reduced, the poses are what is to be eliminated. Views alternate between the
/// sensors, and every third is seen by two, so that terms see different lists of reduced blocks.
pub struct Clouds {
    pub parameters: Parameters,
    pub sensors: Vec<BlockId>,
    pub poses: Vec<BlockId>,
    /// Which sensor sees which pose.
    pub sights: Vec<(usize, usize)>,
    points: Vec<Vector3<f64>>,
    /// What each sight measured.
    measured: Vec<Vec<Vector3<f64>>>,
}

impl Clouds {
    pub fn new(n_sensors: usize, n_views: usize, n_points: usize, elimination: Elimination) -> Self {
        let mut numbers = Numbers::new(7);
        let vector = |numbers: &mut Numbers, size: f64| {
            Vector3::new(size * numbers.next(), size * numbers.next(), size * numbers.next())
        };
        let mut parameters = Parameters::default();
        let points: Vec<Vector3<f64>> = (0..n_points).map(|_| vector(&mut numbers, 1.0)).collect();
        let distortions: Vec<[f64; 6]> =
            (0..n_sensors).map(|_| std::array::from_fn(|_| 0.05 * numbers.next())).collect();
        let sensors = (0..n_sensors).map(|_| parameters.add_vector(&[0.0; 6])).collect();
        let (mut poses, mut sights, mut measured) = (Vec::new(), Vec::new(), Vec::new());
        for view in 0..n_views {
            let truth = Pose::from_rodrigues(vector(&mut numbers, 1.5), vector(&mut numbers, 2.0));
            let start = Pose::from_rodrigues(vector(&mut numbers, 0.2), vector(&mut numbers, 0.2)) * truth;
            for sensor in (view..=view + usize::from(view % 3 == 0)).take(n_sensors).map(|k| k % n_sensors) {
                let distort = distortion(&distortions[sensor]);
                let measure = |point: &Vector3<f64>| distort * (truth * *point) + vector(&mut numbers, 1e-2);
                measured.push(points.iter().map(measure).collect());
                sights.push((sensor, view));
            }
            poses.push(parameters.add_pose(&start, elimination));
        }
        Self { parameters, sensors, poses, sights, points, measured }
    }

    /// Returns a sight's rows of `[J r]` over its blocks, in units of the noise.
    pub fn rows(&self, sight: usize, values: Values<'_>) -> Vec<Vec<f64>> {
        let (sensor, view) = self.sights[sight];
        let distort = distortion(values.vector(self.sensors[sensor]));
        let pose = values.pose(self.poses[view]);
        let mut rows = Vec::new();
        for (point, measured) in self.points.iter().zip(&self.measured[sight]) {
            let seen = pose * *point;
            let error = distort * seen - measured;
            let by_rotation = distort * -skew(&seen);
            for k in 0..3 {
                let mut row = [0.0; 13];
                for (column, &(_, j)) in TRIANGLE.iter().enumerate().filter(|(_, entry)| entry.0 == k) {
                    row[column] = seen[j];
                }
                for j in 0..3 {
                    row[6 + j] = by_rotation[(k, j)];
                    row[9 + j] = distort[(k, j)];
                }
                if sight % 2 == 1 {
                    row[..12].rotate_left(6);
                }
                row[12] = error[k];
                rows.push(row.iter().map(|entry| entry * 100.0).collect());
            }
        }
        rows
    }

    /// Returns all residuals.
    pub fn residuals(&self, values: Values<'_>) -> Vec<f64> {
        (0..self.sights.len()).flat_map(|sight| self.rows(sight, values)).map(|row| row[12]).collect()
    }

    /// Returns a sight's blocks: sensor and pose, or pose and sensor, because both must do.
    fn sight_blocks(&self, sight: usize) -> [BlockId; 2] {
        let (sensor, view) = self.sights[sight];
        let mut blocks = [self.sensors[sensor], self.poses[view]];
        if sight % 2 == 1 {
            blocks.reverse();
        }
        blocks
    }

    /// Returns the terms, one for each sight.
    pub fn terms(&self) -> Vec<Function<impl Fn(Values<'_>) -> Rows + Send + Sync + '_>> {
        let term = |sight: usize| {
            let n_rows = 3 * self.points.len();
            Function::new(&self.sight_blocks(sight), n_rows, move |values| Some(self.rows(sight, values)))
        };
        (0..self.sights.len()).map(term).collect()
    }

    /// Returns all blocks.
    pub fn blocks(&self) -> Vec<BlockId> {
        self.sensors.iter().chain(&self.poses).copied().collect()
    }
}

/// The entries of an upper triangle.
const TRIANGLE: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

fn distortion(entries: &[f64]) -> Matrix3<f64> {
    let mut matrix = Matrix3::identity();
    for (&(i, j), entry) in TRIANGLE.iter().zip(entries) {
        matrix[(i, j)] += entry;
    }
    matrix
}

/// Returns terms as a problem takes them.
pub fn as_terms<T: Term>(terms: &[T]) -> Vec<&dyn Term> {
    terms.iter().map(|term| term as &dyn Term).collect()
}
