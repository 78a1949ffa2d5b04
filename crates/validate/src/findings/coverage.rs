//! A part of the image in which nothing was seen.

use boresight_camera::Camera;
use boresight_data::{CameraId, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The image is divided into this many columns and rows of cells.
const CELLS: usize = 10;

/// The share of cells with a corner below which the lens is extrapolated in too much of the image.
const CAUTION_BELOW: f64 = 0.6;

/// The names of the image's regions, row by row; the cells in the middle are one more across.
const REGIONS: [[&str; 3]; 3] = [
    ["top-left corner", "top edge", "top-right corner"],
    ["left edge", "middle", "right edge"],
    ["bottom-left corner", "bottom edge", "bottom-right corner"],
];

/// A part of the image in which nothing was seen.
pub(super) struct Coverage;

impl Diagnostic for Coverage {
    const CODE: &'static str = "coverage";

    const EXPLANATION: &'static str = "\
What it means: the image is divided into 10 x 10 cells, and in fewer than 60 %
of them any corner of a target was used. Cells that the lens does not reach at
all, such as the black corners of a fisheye's image, do not count. The message
names the emptiest region.

Why it matters: where nothing was seen, the lens model is extrapolated.
Distortion grows with the third and higher powers of the distance from the
middle, so an error that is invisible where the boards were can be many pixels
in a corner. Residuals cannot show it: there are none there.

How to fix it: take views with the board in the named region, cut by the border
of the image if the detector can handle partial boards, tilted otherwise so that
its corners reach out. Come closer: a board that fills the image covers most
cells at once. If that part of the image is never used, the finding can be
accepted.";

    fn find(case: &Case) -> Vec<Found> {
        let estimated = case.cameras().filter(|(_, name, _)| !case.lens_is_held(name));
        let found = estimated.filter_map(|(id, name, placed)| {
            let cells = seen_by(case, id, &placed.camera);
            let share = cells.share()?;
            if share >= CAUTION_BELOW {
                return None;
            }
            let region = cells.emptiest_region();
            Some(Found {
                severity: Severity::Caution,
                place: name.to_owned(),
                message: format!(
                    "corners were seen in {:.0} % of the image; the emptiest region is the {region}",
                    100.0 * share
                ),
                measured: Some(share),
                limit: Some(CAUTION_BELOW),
                fix: format!(
                    "Take views with the board in the {region}, and closer ones that fill the image."
                ),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        let [width, height] = example.dataset.cameras[boresight_data::CameraId(0)].image_size.map(f64::from);
        for view in &mut example.dataset.views {
            view.observations.retain(|o| o.pixel[0] > 0.55 * width || o.pixel[1] > 0.9 * height);
        }
        example.refit();
        vec![(example, Severity::Caution)]
    }
}

/// Returns the share of the image in which a camera saw corners, or `None` without a lens.
pub(crate) fn coverage(case: &Case, camera: CameraId) -> Option<f64> {
    let placed = case.calibration.scene.rig.cameras.get(camera)?.as_ref()?;
    seen_by(case, camera, &placed.camera).share()
}

/// Returns the cells in which a camera saw corners.
fn seen_by(case: &Case, id: CameraId, lens: &Camera) -> Cells {
    let mut cells = Cells::new(lens);
    for used in case.used_views_of(id) {
        case.kept(used).for_each(|observation| cells.see(observation.pixel));
    }
    cells
}

/// Which cells of the image were seen.
struct Cells {
    image_size: [f64; 2],
    /// Row by row; `None` where the lens sees nothing.
    seen: Vec<Option<bool>>,
}

impl Cells {
    fn new(camera: &Camera) -> Self {
        let image_size = camera.image_size.map(f64::from);
        let centre = |index: usize, size: f64| (index as f64 + 0.5) / CELLS as f64 * size - 0.5;
        let reach = |i: usize| {
            let pixel = [centre(i % CELLS, image_size[0]), centre(i / CELLS, image_size[1])];
            camera.unproject(pixel).map(|_| false)
        };
        Self { image_size, seen: (0..CELLS * CELLS).map(reach).collect() }
    }

    fn see(&mut self, pixel: [f64; 2]) {
        let index = |axis: usize| {
            let relative = (pixel[axis] + 0.5) / self.image_size[axis] * CELLS as f64;
            // NaN and what is left of the image become zero.
            (relative as usize).min(CELLS - 1)
        };
        let cell = index(1) * CELLS + index(0);
        self.seen[cell] = Some(true);
    }

    /// Returns the share of the cells in sight that were seen, or `None` if the lens sees nothing.
    fn share(&self) -> Option<f64> {
        share(self.seen.iter().flatten().copied())
    }

    fn emptiest_region(&self) -> &'static str {
        // Corners first: of equals, they matter most.
        const ORDER: [(usize, usize); 9] =
            [(0, 0), (0, 2), (2, 0), (2, 2), (0, 1), (1, 0), (1, 2), (2, 1), (1, 1)];
        let region_of = |index: usize| if index < 3 { 0 } else { 1 + usize::from(index >= CELLS - 3) };
        let share_of = |(row, column): (usize, usize)| {
            let cells = self.seen.iter().enumerate();
            let within = cells.filter(|(i, _)| (region_of(i / CELLS), region_of(i % CELLS)) == (row, column));
            share(within.filter_map(|(_, seen)| *seen)).unwrap_or(1.0)
        };
        let emptiest = ORDER.into_iter().min_by(|&one, &other| share_of(one).total_cmp(&share_of(other)));
        let (row, column) = emptiest.unwrap_or((1, 1));
        REGIONS[row][column]
    }
}

fn share(seen: impl Iterator<Item = bool>) -> Option<f64> {
    let (n, n_seen) = seen.fold((0, 0), |(n, n_seen), seen| (n + 1, n_seen + i32::from(seen)));
    (n > 0).then(|| f64::from(n_seen) / f64::from(n))
}

#[cfg(test)]
mod tests {
    use boresight_camera::Model;

    use super::*;

    fn camera(model: Model, params: Vec<f64>) -> Camera {
        Camera::new(model, params, [1000, 500]).unwrap()
    }

    #[track_caller]
    fn check(is_seen: impl Fn(f64, f64) -> bool, region: &str, share: f64) {
        let mut cells =
            Cells::new(&camera(Model::Pinhole(Default::default()), vec![500.0, 500.0, 499.5, 249.5]));
        for i in 0..CELLS * CELLS {
            let (x, y) = ((i % CELLS) as f64 + 0.5, (i / CELLS) as f64 + 0.5);
            if is_seen(x, y) {
                cells.see([100.0 * x - 0.5, 50.0 * y - 0.5]);
            }
        }
        assert_eq!((cells.emptiest_region(), cells.share()), (region, Some(share)));
    }

    #[test]
    fn regions_have_names() {
        check(|_, _| false, "top-left corner", 0.0);
        check(|x, y| x > 3.0 || y > 3.0, "top-left corner", 0.91);
        check(|x, y| x < 7.0 || y < 6.0, "bottom-right corner", 0.88);
        check(|x, y| !(3.0..7.0).contains(&x) || !(3.0..7.0).contains(&y), "middle", 0.84);
        check(|x, y| x > 2.0 || !(3.0..7.0).contains(&y), "left edge", 0.92);
        check(|_, y| y < 7.0, "bottom-left corner", 0.7);
    }

    #[test]
    fn pixels_fall_into_cells() {
        let mut cells =
            Cells::new(&camera(Model::Pinhole(Default::default()), vec![500.0, 500.0, 499.5, 249.5]));
        for pixel in [[-0.5, -0.5], [-3.0, 0.0], [1200.0, 499.4], [999.4, 800.0]] {
            cells.see(pixel);
        }
        let seen: Vec<usize> = (0..100).filter(|&i| cells.seen[i] == Some(true)).collect();
        assert_eq!(seen, [0, 99]);
    }

    #[test]
    fn what_a_fisheye_cannot_see_does_not_count() {
        // 180 degrees at a radius of 250 px, where it folds back: 1 + 3 k1 θ² = 0 at 90 degrees.
        let k1 = -1.0 / (3.0 * std::f64::consts::FRAC_PI_2.powi(2));
        let f = 250.0 / (std::f64::consts::FRAC_PI_2 * 2.0 / 3.0);
        let model = Model::KannalaBrandt4(Default::default());
        let mut cells = Cells::new(&camera(model, vec![f, f, 499.5, 249.5, k1, 0.0, 0.0, 0.0]));
        // A circle of half the image's width covers about π/8 of it.
        let in_sight = cells.seen.iter().flatten().count();
        assert!((36..44).contains(&in_sight), "{in_sight}");
        for i in 0..100 {
            if cells.seen[i].is_some() {
                cells.seen[i] = Some(true);
            }
        }
        assert_eq!(cells.share(), Some(1.0));
    }
}
