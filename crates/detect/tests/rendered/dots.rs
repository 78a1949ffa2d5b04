//! Grids of dots.

use boresight_data::{CircleLayout, Geometry, Shape, Target};
use boresight_detect::{Missed, detect};
use boresight_synthetic::{Exposure, render};

use super::tags::{facing, root_mean_square};
use super::{camera, errors};

pub(super) fn dots(columns: u32, rows: u32, layout: CircleLayout) -> Target {
    let spacing_m = if layout == CircleLayout::Symmetric { 0.035 } else { 0.02 };
    let geometry = Geometry::Circles { columns, rows, spacing_m, layout };
    Target { name: "dots".to_owned(), geometry, shape: Shape::Rigid }
}

#[test]
fn dots_are_where_their_middles_are() {
    let camera = camera();
    let (mut all, mut variances) = (Vec::new(), 0.0);
    for (columns, rows, layout) in [(7, 5, CircleLayout::Symmetric), (4, 11, CircleLayout::Asymmetric)] {
        let target = dots(columns, rows, layout);
        for i in 0..5u32 {
            let t = f64::from(i);
            // No roll beyond what tells which way up a symmetric grid is.
            let roll_deg = if layout == CircleLayout::Symmetric { 15.0 * t } else { 5.0 + 80.0 * t };
            let pose = facing(&target, [0.01, -0.01, 0.40], 12.0 * t, 0.37 * t, roll_deg);
            let exposure = Exposure { blur_px: 0.4 + 0.2 * t, noise: 1.0 + 0.5 * t, ..Exposure::default() };
            let image = render(&camera, &pose, &target, &[], &exposure, u64::from(i)).unwrap();
            let found = detect(&image, &target);
            assert_eq!(
                (found.missed, found.observations.len()),
                (None, target.point_count()),
                "{layout:?} {i}"
            );
            let of_image = errors(&found, &camera, &pose, &target);
            let mean =
                [0, 1].map(|axis| of_image.iter().map(|e| e[axis]).sum::<f64>() / of_image.len() as f64);
            println!("{layout:?} {i}: rms {:.4} mean {mean:.4?}", root_mean_square(&of_image));
            // Uncorrected, perspective moves middles by 0.1 px and more at such tilts.
            assert!(mean.iter().all(|mean| mean.abs() < 0.02), "{layout:?} {i}: {mean:?}");
            all.extend(of_image);
            variances += found.observations.iter().map(|o| o.sigma_px.powi(2)).sum::<f64>();
        }
    }
    let rms = root_mean_square(&all);
    let ratio = rms / (variances / all.len() as f64).sqrt();
    println!("rms {rms:.4} px, of the stated sigma {ratio:.3}");
    assert!(rms < 0.03, "{rms}");
    assert!((ratio - 1.0).abs() < 0.4, "{ratio}");
}

#[test]
fn grids_of_another_size_are_told() {
    let camera = camera();
    let printed = dots(7, 5, CircleLayout::Symmetric);
    let pose = facing(&printed, [0.01, -0.01, 0.40], 20.0, 0.1, 10.0);
    let image = render(&camera, &pose, &printed, &[], &Exposure::default(), 1).unwrap();
    let other = Some(Missed::OtherDots { columns: 7, rows: 5, layout: CircleLayout::Symmetric });
    for (columns, rows, expected) in [(7, 5, None), (5, 7, None), (6, 5, other), (8, 6, other)] {
        let found = detect(&image, &dots(columns, rows, CircleLayout::Symmetric));
        assert_eq!(found.missed, expected, "{columns}x{rows}");
    }
    assert_eq!(detect(&image, &dots(4, 11, CircleLayout::Asymmetric)).missed, other);
    // Cut by the border, it could be any part.
    let aside = facing(&printed, [0.16, 0.0, 0.40], 10.0, 0.1, 10.0);
    let image = render(&camera, &aside, &printed, &[], &Exposure::default(), 1).unwrap();
    assert!(detect(&image, &printed).observations.is_empty());
}
