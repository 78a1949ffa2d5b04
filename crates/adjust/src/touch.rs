//! Camera to robot plane, by touched points: Eqs 8.23 to 8.27 and beyond them.
//!
//! The textbook takes the image plane for parallel to the robot's and the lens for free of distortion: a
//! similarity of pixels. Here several maps are fitted to any number of touches, with or without the lens,
//! and touches left out of their fits choose among them. With the map come the height
//! and slopes of the plane, the offset of the touching tip where touches turn enough to show it, and the
//! joint covariance of all of them with the lens.
//!
//! Long because the fits of all models share one setup.

mod checks;
mod map;
mod position;
mod term;

use boresight_camera::Camera;
use boresight_data::{PlaneLens, PlaneModel, RobotPlane};
use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Matrix3, Pose, Vector3};
use boresight_solver::{
    BlockId, Elimination, Parameters, Problem, SolveOptions, Term as _, covariance, solve,
};

use self::checks::{Normaliser, breadth, check_spread, renormalised, tip_of};
use self::map::{Kind, linear_start, mapped, pose_of_homography};
use self::term::{Held, Tip, TouchTerm};

pub use self::position::{PlaneFunction, Position, plane_columns, plane_position, plane_spread};

/// A point that is seen by the camera and touched by the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    /// Its name.
    pub name: String,
    /// Where it is seen.
    pub pixel: [f64; 2],
    /// Where the robot was: the flange's pose, or the touched point alone with no rotation.
    pub base_from_flange: Pose,
}

/// How touches are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heights {
    /// With their height.
    Known,
    /// Without: the plane is that of z = 0.
    Unknown,
}

/// What is known of the touching tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TipKnowledge {
    /// Its position on the flange, in metres; zero where touches are given as touched points.
    Known([f64; 3]),
    /// It is to be found.
    Unknown,
}

/// How a plane is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchOptions {
    /// The standard deviation of a pixel coordinate.
    pub sigma_px: f64,
    /// The standard deviation of a touched coordinate, in metres; `None` estimates it from the residuals.
    pub sigma_touch_m: Option<f64>,
    /// What is known of the tip.
    pub tip: TipKnowledge,
    /// Whether heights are given.
    pub heights: Heights,
    /// The model; `None` lets left-out touches choose.
    pub model: Option<PlaneModel>,
}

/// A lens to be used, with what is known of its errors.
#[derive(Clone, Copy, Debug)]
pub struct TouchLens<'a> {
    /// The camera's name.
    pub name: &'a str,
    /// The lens.
    pub camera: &'a Camera,
    /// The covariance of its parameters, where known.
    pub covariance: Option<&'a DMatrix<f64>>,
}

/// A model that was tried.
#[derive(Clone, Debug, PartialEq)]
pub struct TriedModel {
    /// The model.
    pub model: PlaneModel,
    /// The root of the mean squared distance, in the plane, of each touch from where the fit to the
    /// others predicts it, in metres; `None` where the others do not determine the model.
    pub left_out_rms_m: Option<f64>,
    /// The same of the fit to all touches; `None` where they do not determine it.
    pub rms_m: Option<f64>,
}

/// How one touch is met.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchFit {
    /// Its name.
    pub name: String,
    /// Mapped minus touched position, and the plane's height there minus the touched one, in metres.
    pub residual_m: [f64; 3],
    /// Predicted minus touched position by the fit to all other touches, in metres; `None` where they
    /// do not determine it.
    pub left_out_m: Option<[f64; 2]>,
}

/// A plane and how well it meets its touches.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchedPlane {
    /// The plane.
    pub plane: RobotPlane,
    /// All models that were tried, the simplest first; only one if that was asked for.
    pub tried: Vec<TriedModel>,
    /// How each touch is met.
    pub touches: Vec<TouchFit>,
    /// The factor by which the stated sigmas must grow to explain the residuals; `None` without degrees of freedom.
    pub noise_factor: Option<f64>,
    /// Equations minus unknowns.
    pub degrees_of_freedom: usize,
    /// The sigma of a touched coordinate that the covariance rests on, in metres.
    pub sigma_touch_m: f64,
    /// The number of directions in which the tip was sought: none, two or three.
    pub tip_directions: usize,
}

/// What keeps a plane from being found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TouchError {
    /// There are too few touches at distinct points.
    #[error("{found} touches at distinct points are given; {need} are needed")]
    TooFewTouches {
        /// How many distinct ones are given.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// The touches lie on a line.
    #[error(
        "the touches lie on a line: they spread {ratio:.1e} as far across as along it, at least {limit:.0e} is needed"
    )]
    Collinear {
        /// Their extent across over that along.
        ratio: f64,
        /// The least ratio accepted.
        limit: f64,
    },
    /// A pixel has no direction in the lens.
    #[error("touch {name}: the pixel ({:.1}, {:.1}) has no direction in front of the camera", pixel[0], pixel[1])]
    NoDirection {
        /// The touch.
        name: String,
        /// The pixel.
        pixel: [f64; 2],
    },
    /// The touches do not turn enough to show the tip's offset.
    #[error(
        "the tip's offset is open: the touches turn by {spread_rad:.2e} rad, at least {limit_rad} rad is needed"
    )]
    TipOpen {
        /// The spread of the flange's orientation about its second widest axis, in radians.
        spread_rad: f64,
        /// The least spread accepted.
        limit_rad: f64,
    },
    /// No model fits, or not the one asked for.
    #[error("the touches do not determine {}", model.map_or("any model", PlaneModel::name))]
    NoModel {
        /// The model asked for; `None` if any would do.
        model: Option<PlaneModel>,
    },
    /// A model needs the lens.
    #[error("model {} needs a calibrated lens", model.name())]
    NoLens {
        /// The model.
        model: PlaneModel,
    },
    /// The plane cannot be found with a lens that is hardly another.
    #[error(
        "with the lens's {parameter} moved by a tenth of its sigma, the touches do not determine the plane"
    )]
    LensUnsteady {
        /// The parameter.
        parameter: &'static str,
    },
    /// Nothing tells how well the plane is known.
    #[error("{touches} touches leave no degree of freedom to estimate their sigma from")]
    NoSigma {
        /// The number of touches.
        touches: usize,
    },
    /// The solver failed.
    #[error(transparent)]
    Solver(#[from] boresight_solver::Error),
}

/// The least extent of the touches across their line, over that along it.
pub const LEAST_BREADTH: f64 = 0.01;

/// The least spread of the flange's orientations that shows the tip, in radians.
pub const LEAST_TURN_RAD: f64 = 0.05;

/// A sigma of touches that is as good as any as long as residuals scale it.
const NOMINAL_SIGMA_M: f64 = 1e-4;

/// Fits a plane to touches.
pub fn touched_plane(
    touches: &[Touch],
    lens: Option<TouchLens<'_>>,
    options: &TouchOptions,
) -> Result<TouchedPlane, TouchError> {
    let setup = Setup::new(touches, lens, options)?;
    let all: Vec<usize> = (0..touches.len()).collect();
    let mut tried = Vec::new();
    let mut predictions = Vec::new();
    let asked = |model: &PlaneModel| options.model.is_none_or(|asked| asked == *model);
    for model in PlaneModel::ALL.into_iter().filter(asked) {
        if model.needs_lens() && lens.is_none() {
            continue;
        }
        let fit = setup.fit(model, &all);
        let errors =
            fit.as_ref().map(|fit| fit.errors.iter().map(|e| e[0] * e[0] + e[1] * e[1]).sum::<f64>());
        let mean = |sum: f64| (sum / touches.len() as f64).sqrt();
        let left_out = setup.left_out(model);
        let squares: Option<f64> = left_out.iter().map(|e| e.map(|[x, y]| x * x + y * y)).sum();
        let left_out_rms_m = fit.as_ref().and(squares).map(mean);
        tried.push(TriedModel { model, left_out_rms_m, rms_m: errors.map(mean) });
        predictions.push((model, left_out));
    }
    let model = match options.model {
        Some(model) if model.needs_lens() && lens.is_none() => return Err(TouchError::NoLens { model }),
        Some(model) => model,
        None => {
            // Without any prediction, the simplest that the touches determine.
            let simplest = || tried.iter().find(|tried| tried.rms_m.is_some()).map(|tried| tried.model);
            chosen_model(&tried, &predictions).or_else(simplest).ok_or(TouchError::NoModel { model: None })?
        }
    };
    let fit = setup.fit(model, &all).ok_or(TouchError::NoModel { model: Some(model) })?;
    let left_out =
        predictions.into_iter().find(|(of, _)| *of == model).map_or(Vec::new(), |(_, found)| found);
    setup.report(model, fit, tried, left_out)
}

/// What a model predicts of each touch from all others, less where it was touched.
type Predictions = (PlaneModel, Vec<Option<[f64; 2]>>);

/// Returns the model that predicts left-out touches best; but the pose of the calibrated camera where nothing
/// predicts them better by more than the standard error of the difference.
///
/// Of the models that hold for a true lens the pose has the fewest unknowns. Nine touches tell a model that
/// errs at once, but hardly two that are both true, and by their chance the worse one would be taken as often
/// as not: the one-standard-error rule (Breiman, Friedman, Olshen & Stone 1984, section 3.4.3).
fn chosen_model(tried: &[TriedModel], predictions: &[Predictions]) -> Option<PlaneModel> {
    let predicted = tried.iter().filter_map(|tried| Some((tried.model, tried.left_out_rms_m?)));
    let best = predicted.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(model, _)| model)?;
    let squares_of = |wanted: PlaneModel| -> Option<Vec<f64>> {
        let (_, errors) = predictions.iter().find(|(model, _)| *model == wanted)?;
        errors.iter().map(|error| error.map(|[x, y]| x * x + y * y)).collect()
    };
    let is_fitted = tried.iter().any(|tried| tried.model == PlaneModel::Pose && tried.rms_m.is_some());
    let (Some(of_pose), Some(of_best)) =
        (squares_of(PlaneModel::Pose).filter(|_| is_fitted), squares_of(best))
    else {
        return Some(best);
    };
    let differences: Vec<f64> = of_pose.iter().zip(&of_best).map(|(pose, best)| pose - best).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let square: f64 = differences.iter().map(|difference| (difference - mean).powi(2)).sum();
    let standard_error = (square / (n * (n - 1.0))).sqrt();
    // Of one touch nothing is known of the error: NaN keeps the best.
    Some(if mean <= standard_error { PlaneModel::Pose } else { best })
}

/// Everything that the fits of all models share.
struct Setup<'a> {
    touches: &'a [Touch],
    lens: Option<TouchLens<'a>>,
    options: &'a TouchOptions,
    /// `x / z, y / z` of each touch, where there is a lens.
    directions: Vec<[f64; 2]>,
    tip: Tip,
    /// The tip's position by what is known of it, in the base frame.
    positions: Vec<Vector3<f64>>,
    centre: [f64; 2],
    scale: f64,
    facing: f64,
}

/// A model fitted to some touches.
struct Fit {
    kind: Kind,
    parameters: Parameters,
    term: TouchTerm,
    /// Errors of the touches it was fitted to, in metres.
    errors: Vec<[f64; 3]>,
    normaliser: Normaliser,
}

impl<'a> Setup<'a> {
    fn new(
        touches: &'a [Touch],
        lens: Option<TouchLens<'a>>,
        options: &'a TouchOptions,
    ) -> Result<Self, TouchError> {
        let tip = tip_of(touches, options.tip)?;
        let positions: Vec<Vector3<f64>> =
            touches.iter().map(|touch| touch.base_from_flange * tip.known).collect();
        let flat: Vec<[f64; 2]> = positions.iter().map(|p| [p.x, p.y]).collect();
        let pixels: Vec<[f64; 2]> = touches.iter().map(|touch| touch.pixel).collect();
        check_spread(&flat, options.tip)?;
        check_spread(&pixels, TipKnowledge::Known([0.0; 3]))?;
        let mut directions = Vec::new();
        if let Some(lens) = lens {
            for touch in touches {
                let direction = lens.camera.unproject(touch.pixel).filter(|ray| ray.z > 1e-3);
                let no_direction =
                    || TouchError::NoDirection { name: touch.name.clone(), pixel: touch.pixel };
                let ray = direction.ok_or_else(no_direction)?;
                directions.push([ray.x / ray.z, ray.y / ray.z]);
            }
        }
        let Normaliser { centre, scale } = Normaliser::of(&flat);
        let mut setup =
            Self { touches, lens, options, directions, tip, positions, centre, scale, facing: 1.0 };
        // The side from which the plane is seen is that of the similarity that fits better.
        let image = Normaliser::of(&pixels);
        let image: Vec<[f64; 2]> = pixels.iter().map(|&pixel| image.apply(pixel)).collect();
        let robot = setup.normalised();
        let misfit = |facing: f64| {
            let Some(map) = linear_start(Kind::Similarity, facing, &image, &robot) else {
                return f64::INFINITY;
            };
            let error = |(&image, robot): (&[f64; 2], &[f64; 2])| {
                let [x, y] = mapped(Kind::Similarity, facing, &map, image).unwrap_or([f64::INFINITY; 2]);
                (x - robot[0]).powi(2) + (y - robot[1]).powi(2)
            };
            image.iter().zip(&robot).map(error).sum()
        };
        if misfit(-1.0) < misfit(1.0) {
            setup.facing = -1.0;
        }
        Ok(setup)
    }

    fn normalised(&self) -> Vec<[f64; 2]> {
        let one =
            |p: &Vector3<f64>| [(p.x - self.centre[0]) / self.scale, (p.y - self.centre[1]) / self.scale];
        self.positions.iter().map(one).collect()
    }

    fn image(&self, model: PlaneModel) -> Vec<[f64; 2]> {
        if model.needs_lens() {
            self.directions.clone()
        } else {
            self.touches.iter().map(|touch| touch.pixel).collect()
        }
    }

    /// Fits a model to the chosen touches, or returns `None` if they do not determine it.
    fn fit(&self, model: PlaneModel, chosen: &[usize]) -> Option<Fit> {
        let kind = Kind::of(model);
        if chosen.len() < kind.least_touches() {
            return None;
        }
        let image = self.image(model);
        let all_robot = self.normalised();
        let robot: Vec<[f64; 2]> = chosen.iter().map(|&i| all_robot[i]).collect();
        let used: Vec<[f64; 2]> = chosen.iter().map(|&i| image[i]).collect();
        let normaliser = Normaliser::of(&used);
        let normalised: Vec<[f64; 2]> = used.iter().map(|&point| normaliser.apply(point)).collect();
        let start = linear_start(kind, self.facing, &normalised, &robot)?;
        let height = self.height_start(chosen)?;
        let mut parameters = Parameters::default();
        let map_block = match kind {
            Kind::Pose => {
                let base_from_image = self.denormalised(&start, &normaliser);
                let pose = pose_of_homography(&base_from_image, &height, self.centre)?;
                parameters.add_pose(&pose, Elimination::Reduced)
            }
            _ => parameters.add_vector(&start),
        };
        let plane_block = parameters.add_vector(&height);
        if self.options.heights == Heights::Unknown {
            parameters.hold_all(plane_block);
        }
        let mut blocks = vec![map_block, plane_block];
        if !self.tip.sought.is_empty() {
            blocks.push(parameters.add_vector(&vec![0.0; self.tip.sought.len()]));
        }
        let mut term = TouchTerm {
            blocks,
            kind,
            facing: self.facing,
            centre: self.centre,
            scale: self.scale,
            tip: self.tip.clone(),
            touches: Vec::new(),
        };
        let metres_per_unit = self.metres_per_unit(kind, &start, &normaliser);
        for &i in chosen {
            let coordinates = if kind == Kind::Pose { image[i] } else { normaliser.apply(image[i]) };
            term.touches.push(self.held(model, i, coordinates, metres_per_unit));
        }
        let problem = Problem::new(&parameters, vec![&term]).ok()?;
        let options = SolveOptions { decrease_below: 1e-10, threads: 1, ..SolveOptions::default() };
        let solution = solve(&problem, &options).ok().filter(|solution| solution.stop.is_converged())?;
        parameters.set_values(&solution.values);
        let errors = term.errors_m(&parameters.values())?;
        Some(Fit { kind, parameters, term, errors, normaliser })
    }

    /// Returns a touch with the inverse of the sigmas of its errors in the plane.
    ///
    /// Pixels and touches err independently; a pixel's error is spread over the plane by the local
    /// scale of the map, which is all but the same in both directions.
    fn held(&self, model: PlaneModel, i: usize, image: [f64; 2], metres_per_unit: f64) -> Held {
        let units_per_px = match (model.needs_lens(), self.lens) {
            (true, Some(lens)) => 2.0 / (lens.camera.params[0] + lens.camera.params[1]),
            _ => 1.0,
        };
        let touch_sigma = self.options.sigma_touch_m.unwrap_or(NOMINAL_SIGMA_M);
        let pixel_sigma = match self.options.sigma_touch_m {
            Some(_) => self.options.sigma_px * units_per_px * metres_per_unit,
            // Residuals then scale one sigma of everything.
            None => 0.0,
        };
        let inverse = 1.0 / touch_sigma.hypot(pixel_sigma);
        let inverse_height_sigma = match self.options.heights {
            Heights::Known => 1.0 / touch_sigma,
            Heights::Unknown => 0.0,
        };
        Held {
            image,
            base_from_flange: self.touches[i].base_from_flange,
            whitening: [[inverse, 0.0], [0.0, inverse]],
            inverse_height_sigma,
        }
    }

    /// Returns by how many metres the map moves for one unit of image coordinates, near the centre.
    fn metres_per_unit(&self, kind: Kind, start: &[f64], normaliser: &Normaliser) -> f64 {
        let determinant = match kind {
            Kind::Similarity => start[0] * start[0] + start[1] * start[1],
            _ => (start[0] * start[4] - start[1] * start[3]).abs(),
        };
        determinant.sqrt() * self.scale / normaliser.scale
    }

    /// Returns the matrix that takes `(x / z, y / z, 1)` to multiples of `(X, Y, 1)` less the centre, in metres.
    fn denormalised(&self, map: &[f64], normaliser: &Normaliser) -> Matrix3<f64> {
        let homography = Matrix3::new(map[0], map[1], map[2], map[3], map[4], map[5], map[6], map[7], 1.0);
        let (s, [cx, cy]) = (1.0 / normaliser.scale, normaliser.centre);
        let normalise = Matrix3::new(s, 0.0, -s * cx, 0.0, s, -s * cy, 0.0, 0.0, 1.0);
        Matrix3::from_diagonal(&Vector3::new(self.scale, self.scale, 1.0)) * homography * normalise
    }

    /// Returns the plane through the touched heights by least squares.
    fn height_start(&self, chosen: &[usize]) -> Option<[f64; 3]> {
        if self.options.heights == Heights::Unknown {
            return Some([0.0; 3]);
        }
        let n = chosen.len() as f64;
        let mean = chosen.iter().map(|&i| self.positions[i].z).sum::<f64>() / n;
        if chosen.len() < 3 {
            return Some([mean, 0.0, 0.0]);
        }
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for &i in chosen {
            let p = self.positions[i];
            let row =
                Vector3::new(1.0, (p.x - self.centre[0]) / self.scale, (p.y - self.centre[1]) / self.scale);
            normal += row * row.transpose();
            right += row * p.z;
        }
        let solved = normal.cholesky().map(|factor| factor.solve(&right))?;
        Some([solved.x, solved.y / self.scale, solved.z / self.scale])
    }

    /// Returns for each touch where the fit to all others predicts it, less where it is.
    fn left_out(&self, model: PlaneModel) -> Vec<Option<[f64; 2]>> {
        let n = self.touches.len();
        let one = |left_out: usize| {
            let others: Vec<usize> = (0..n).filter(|&i| i != left_out).collect();
            let flat: Vec<[f64; 2]> =
                others.iter().map(|&i| [self.positions[i].x, self.positions[i].y]).collect();
            if Kind::of(model) != Kind::Similarity && breadth(&flat) < LEAST_BREADTH {
                return None;
            }
            let mut fit = self.fit(model, &others)?;
            let image = self.image(model)[left_out];
            let image = if fit.kind == Kind::Pose { image } else { fit.normaliser.apply(image) };
            let held = Held {
                image,
                base_from_flange: self.touches[left_out].base_from_flange,
                ..fit.term.touches[0]
            };
            fit.term.touches = vec![held];
            let errors = fit.term.errors_m(&fit.parameters.values())?;
            Some([errors[0][0], errors[0][1]])
        };
        (0..n).map(one).collect()
    }

    /// Returns the plane of a fit with its covariance.
    fn report(
        &self,
        model: PlaneModel,
        fit: Fit,
        tried: Vec<TriedModel>,
        left_out: Vec<Option<[f64; 2]>>,
    ) -> Result<TouchedPlane, TouchError> {
        let Fit { kind, parameters, term, errors, normaliser } = fit;
        let problem = Problem::new(&parameters, vec![&term])?;
        let options = SolveOptions { threads: 1, ..SolveOptions::default() };
        let known = covariance(&problem, parameters.values().as_slice(), &options)?;
        let degrees_of_freedom = term.row_count().saturating_sub(parameters.free_count());
        let noise_factor =
            (degrees_of_freedom > 0).then(|| (known.observation_cost / degrees_of_freedom as f64).sqrt());
        // Stated sigmas hold as long as the residuals do not contradict them.
        let (factor, sigma_touch_m) = match (self.options.sigma_touch_m, noise_factor) {
            (Some(sigma), Some(noise)) => {
                (if noise > contradiction(degrees_of_freedom) { noise } else { 1.0 }, sigma)
            }
            (Some(sigma), None) => (1.0, sigma),
            (None, Some(noise)) => (noise, NOMINAL_SIGMA_M),
            (None, None) => return Err(TouchError::NoSigma { touches: self.touches.len() }),
        };
        let columns: Vec<(BlockId, usize)> = term.blocks[..2]
            .iter()
            .flat_map(|&block| parameters.columns(block).enumerate().map(move |(i, _)| (block, i)))
            .collect();
        let n = columns.len();
        let own = DMatrix::from_fn(n, n, |a, b| factor * factor * known.between(columns[a], columns[b]));
        let values = parameters.values();
        let map: Vec<f64> = match kind {
            Kind::Pose => {
                let pose = values.pose(term.blocks[0]);
                let [x, y, z] = pose.translation.into();
                pose.rotation.coords.iter().copied().chain([x, y, z]).collect()
            }
            _ => values.vector(term.blocks[0]).to_vec(),
        };
        let height = values.vector(term.blocks[1]);
        let tip_in_flange_m = match self.options.tip {
            TipKnowledge::Known(tip) => (tip != [0.0; 3]).then_some(tip),
            TipKnowledge::Unknown => {
                let along = term.blocks.get(2).map_or(&[][..], |&block| values.vector(block));
                let sum = self.tip.sought.iter().zip(along).fold(self.tip.known, |sum, (d, a)| sum + d * *a);
                Some(sum.into())
            }
        };
        let used = if model.needs_lens() { self.lens } else { None };
        let normaliser =
            if kind == Kind::Pose { Normaliser { centre: [0.0; 2], scale: 1.0 } } else { normaliser };
        let mut plane = RobotPlane {
            model,
            lens: used.map(|lens| PlaneLens {
                camera: lens.name.to_owned(),
                model: lens.camera.model.name().to_owned(),
                params: lens.camera.params.clone(),
                image_size: lens.camera.image_size,
            }),
            image_centre: normaliser.centre,
            image_scale: normaliser.scale,
            robot_scale_m: self.scale,
            robot_centre_m: self.centre,
            facing: self.facing,
            map,
            height_m: [height[0], height[1], height[2]],
            camera_in_base_m: None,
            tip_in_flange_m,
            names: plane_columns(model, used.map(|lens| lens.camera)),
            covariance: Vec::new(),
        };
        plane.camera_in_base_m = self.camera_in_base(model, &plane);
        let joint = self.with_lens(model, &plane, own)?;
        plane.covariance = joint.transpose().iter().copied().collect();
        let touches = self.touches.iter().zip(errors).zip(left_out);
        let touches = touches
            .map(|((touch, residual_m), left_out_m)| TouchFit {
                name: touch.name.clone(),
                residual_m,
                left_out_m,
            })
            .collect();
        Ok(TouchedPlane {
            plane,
            tried,
            touches,
            noise_factor,
            degrees_of_freedom,
            sigma_touch_m: sigma_touch_m * factor,
            tip_directions: self.tip.sought.len(),
        })
    }

    /// Returns where the camera is: of the model's own pose, or of the pose fitted beside it.
    fn camera_in_base(&self, model: PlaneModel, plane: &RobotPlane) -> Option<[f64; 3]> {
        if model == PlaneModel::Pose {
            return Some([plane.map[4], plane.map[5], plane.map[6]]);
        }
        self.lens?;
        let all: Vec<usize> = (0..self.touches.len()).collect();
        let fit = self.fit(PlaneModel::Pose, &all)?;
        Some(fit.parameters.values().pose(fit.term.blocks[0]).translation.into())
    }

    /// Returns the joint covariance of map, plane and lens: the fit moves with the lens it was made with.
    fn with_lens(
        &self,
        model: PlaneModel,
        plane: &RobotPlane,
        own: DMatrix<f64>,
    ) -> Result<DMatrix<f64>, TouchError> {
        let Some(lens) = self.lens.filter(|_| model.needs_lens()) else { return Ok(own) };
        let (n, m) = (own.nrows(), lens.camera.params.len());
        let mut joint = DMatrix::zeros(n + m, n + m);
        joint.view_mut((0, 0), (n, n)).copy_from(&own);
        let Some(covariance) = lens.covariance else { return Ok(joint) };
        let mut gain = DMatrix::zeros(n, m);
        for i in 0..m {
            let sigma = covariance[(i, i)].max(0.0).sqrt();
            if sigma == 0.0 {
                continue;
            }
            // Differences over a tenth of a sigma: the fit is all but linear there.
            let step = 0.1 * sigma;
            let moved = [1.0, -1.0].map(|sign| self.refitted(model, plane, lens, i, sign * step));
            // A plane that stays as it is would hide what the lens brings to its uncertainty.
            let [Some(up), Some(down)] = moved else {
                return Err(TouchError::LensUnsteady { parameter: lens.camera.model.param_names()[i] });
            };
            for row in 0..n {
                gain[(row, i)] = (up[row] - down[row]) / (2.0 * step);
            }
        }
        let cross = &gain * covariance;
        joint.view_mut((0, 0), (n, n)).copy_from(&(own + &cross * gain.transpose()));
        joint.view_mut((0, n), (n, m)).copy_from(&cross);
        joint.view_mut((n, 0), (m, n)).copy_from(&cross.transpose());
        joint.view_mut((n, n), (m, m)).copy_from(covariance);
        Ok(joint)
    }

    /// Returns by how much the columns of map and plane move when a lens parameter does.
    fn refitted(
        &self,
        model: PlaneModel,
        plane: &RobotPlane,
        lens: TouchLens<'_>,
        param: usize,
        step: f64,
    ) -> Option<Vec<f64>> {
        let mut camera = lens.camera.clone();
        camera.params[param] += step;
        let moved_lens = TouchLens { camera: &camera, ..lens };
        let setup = Setup::new(self.touches, Some(moved_lens), self.options).ok()?;
        let all: Vec<usize> = (0..self.touches.len()).collect();
        let fit = setup.fit(model, &all)?;
        let values = fit.parameters.values();
        let mut moved: Vec<f64> = match fit.kind {
            Kind::Pose => {
                let was = position::pose_of(&plane.map);
                let tangent = (values.pose(fit.term.blocks[0]) * was.inverse()).log();
                tangent.iter().copied().collect()
            }
            kind => {
                // The normalisation moved too: the map is brought to that of the plane.
                let map = values.vector(fit.term.blocks[0]);
                let old = Normaliser { centre: plane.image_centre, scale: plane.image_scale };
                let brought = renormalised(kind, self.facing, map, &fit.normaliser, &old);
                brought.iter().zip(&plane.map).map(|(new, old)| new - old).collect()
            }
        };
        let height = values.vector(fit.term.blocks[1]);
        moved.extend(height.iter().zip(&plane.height_m).map(|(new, old)| new - old));
        Some(moved)
    }
}

/// Returns the noise factor beyond which residuals contradict the stated sigmas: three sigmas of its own.
pub fn contradiction(degrees_of_freedom: usize) -> f64 {
    1.0 + 3.0 / (2.0 * degrees_of_freedom as f64).sqrt()
}
