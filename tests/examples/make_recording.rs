//! Makes a recording of a waved chessboard with two cameras of about a megapixel, for measuring.
//!
//! `make_recording OUT.mcap [POSES] [REPEATS] [OFFSET_MS]`: each pose is seen `REPEATS` times with fresh noise, 100 ms apart;
//! the second camera's images are taken, and stamped, `OFFSET_MS` later.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measuring program for developers")]

use std::env;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::thread;

use boresight_data::{GrayImage, GrayPixels, Shape};
use boresight_io::{Packing, RecordingWriter};
use boresight_synthetic::{Exposure, Recipe, render, simulate};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;
use rand_distr::{Distribution as _, Normal};

const IMAGE_SIZE: [u32; 2] = [1200, 900];
const PERIOD_NS: i64 = 100_000_000;

fn main() {
    let arguments: Vec<String> = env::args().collect();
    let [_, out, rest @ ..] = arguments.as_slice() else {
        panic!("usage: make_recording OUT.mcap [POSES] [REPEATS] [OFFSET_MS]");
    };
    let number = |i: usize, default: usize| rest.get(i).map_or(default, |text| text.parse().unwrap());
    let (poses, repeats, offset_ns) = (number(0, 50), number(1, 10), number(2, 0) as i64 * 1_000_000);
    let mut recipe = Recipe::stereo();
    recipe.frames = poses;
    recipe.target.shape = Shape::Rigid;
    recipe.shape_m = Vec::new();
    recipe.placement.image_share = 0.4;
    for placed in &mut recipe.cameras {
        *placed = placed.scaled_to(IMAGE_SIZE);
    }
    let truth = simulate(&recipe, 7).truth;
    let exposure = Exposure { noise: 0.0, ..Exposure::default() };

    let path = Path::new(out);
    let sink = BufWriter::new(File::create(path).unwrap());
    let mut writer = RecordingWriter::new(path, sink, Packing::Zstd).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let noise = Normal::new(0.0, 2.0).unwrap();
    let mut frame = 0_i64;
    for rig_from_target in truth.rig_from_target.iter().flatten() {
        let clean: Vec<GrayImage> = thread::scope(|scope| {
            let rendered = recipe.cameras.iter().map(|placed| {
                let (target, exposure) = (&recipe.target, &exposure);
                let cam_from_target = placed.cam_from_rig * *rig_from_target;
                scope.spawn(move || {
                    render(&placed.camera, &cam_from_target, target, &[], exposure, 0).unwrap()
                })
            });
            let rendered: Vec<_> = rendered.collect();
            rendered.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        for _ in 0..repeats {
            let time = 1_700_000_000_000_000_000 + frame * PERIOD_NS;
            frame += 1;
            for (i, image) in clean.iter().enumerate() {
                let GrayPixels::Eight(values) = image.pixels() else { panic!("eight bits") };
                let noisy =
                    values.iter().map(|value| (f64::from(*value) + noise.sample(&mut rng)).round() as u8);
                let noisy = GrayImage::new(image.size(), GrayPixels::Eight(noisy.collect())).unwrap();
                let stamp = time + i as i64 * offset_ns;
                writer.image(&format!("/rig/cam{i}/image_raw"), stamp, stamp + 3_000_000, &noisy).unwrap();
            }
        }
    }
    writer.finish().unwrap();
    println!("{frame} images of each camera, {} bytes", std::fs::metadata(path).unwrap().len());
}
