//! What reading corners costs, in nanoseconds per corner.
//!
//! `cargo test --release -p boresight-io -- --ignored --nocapture nanoseconds`

use std::time::Instant;

use boresight_data::Target;

use crate::corners_csv::read_csv;
use crate::corners_vnl::read_vnl;
use crate::parse_target;

const IMAGES: usize = 200;
const GRID: usize = 10;

/// Returns corner files of the same corners: vnl as mrgingham writes it, vnl of all digits, and CSV.
fn files() -> [(&'static str, Vec<u8>); 4] {
    let [mut short, mut long, mut narrow] = ["# filename x y level\n"; 3].map(str::to_owned);
    let mut table = "camera,image,view,point,X,Y,Z,u,v\n".to_owned();
    for image in 0..IMAGES {
        for point in 0..GRID * GRID {
            let (column, row) = (point % GRID, point / GRID);
            let u = 100.0 + 91.123456789 * column as f64 + (image as f64).sin();
            let v = 50.0 + 77.987654321 * row as f64 + (image as f64).cos();
            let name = format!("frame{image:05}-cam0.png");
            short += &format!("{name} {u:.6} {v:.6} 0\n");
            long += &format!("{name} {u} {v} 0\n");
            narrow += &format!("{name} {} {} 0\n", f64::from(u as f32), f64::from(v as f32));
            table += &format!("left,{name},{image},{point},{column},{row},0,{u:.6},{v:.6}\n");
        }
    }
    [
        ("vnl, 6 decimals", short),
        ("vnl, floats as doubles", narrow),
        ("vnl, doubles", long),
        ("csv, 6 decimals", table),
    ]
    .map(|(name, text): (_, String)| (name, text.into_bytes()))
}

fn read(name: &str, bytes: &[u8], target: &Target) -> usize {
    let reader = if name.starts_with("csv") { read_csv } else { read_vnl };
    let seen = reader(name, bytes, target, 1.0).unwrap();
    seen.views.iter().map(|view| view.observations.len()).sum()
}

#[test]
#[ignore = "a measurement, which a busy machine would spoil"]
fn nanoseconds_per_corner() {
    let target = parse_target("chessboard:10x10:25mm").unwrap();
    for (name, bytes) in files() {
        let best = (0..400)
            .map(|_| {
                let start = Instant::now();
                assert_eq!(read(name, &bytes, &target), IMAGES * GRID * GRID);
                start.elapsed().as_secs_f64()
            })
            .fold(f64::INFINITY, f64::min);
        let corners = (IMAGES * GRID * GRID) as f64;
        println!(
            "{name}: {:.1} ns per corner, {:.0} MB/s",
            best / corners * 1e9,
            bytes.len() as f64 / best / 1e6
        );
        let start = Instant::now();
        let hash = crate::hash(&bytes);
        println!(
            "  its hash {}...: {:.1} ns per corner",
            &hash[..6],
            start.elapsed().as_secs_f64() / corners * 1e9
        );
    }
}
