//! `boresight target`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    CircleLayout, FirstSquare, Geometry, NotDrawn, OutputFile, Paper, Print, Sheet, Target, sheet,
    write_files,
};
use clap::{Args, Subcommand, ValueEnum};

use crate::failure::{Failure, Reason};
use crate::figures::significant;
use crate::streams::{answer, note};

/// What can be done with targets.
#[derive(Debug, Subcommand)]
pub(crate) enum TargetCommand {
    /// Write a target as an SVG to scale, ready for print, with its part of a job file beside it
    Make(MakeArguments),
}

#[derive(Args, Debug)]
pub(crate) struct MakeArguments {
    /// The target: chessboard:9x6:25mm, charuco:14x9:40mm:30mm:5x5_1000, aprilgrid:6x6:88mm:0.3, circles:7x6:20mm or
    /// acircles:4x11:20mm
    #[arg(value_name = "SPEC", value_parser = crate::inputs::parse_target)]
    pub target: Target,
    /// The file to write; its part of a job file has the same name, with .toml
    #[arg(short, long, value_name = "FILE.svg", default_value = "target.svg")]
    pub output: PathBuf,
    /// The paper: A4, A3, A2, A1, A0, letter, legal, tabloid or WxHmm [default: the smallest of A4 to A0 with room]
    #[arg(long, value_name = "PAPER", value_parser = parse_paper)]
    pub paper: Option<Paper>,
    /// The first square of a ChArUco board: dark, or white as OpenCV before 4.6 has it where rows are even
    #[arg(long, value_enum, default_value_t = SquareColour::Dark)]
    pub first_square: SquareColour,
    /// The width of the black border of an AprilGrid's tags, in modules: 2 as Kalibr has it, or 1
    #[arg(long, value_name = "MODULES", value_parser = clap::value_parser!(u8).range(1..=2), default_value_t = 2)]
    pub tag_border: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SquareColour {
    Dark,
    White,
}

fn parse_paper(text: &str) -> Result<Paper, String> {
    Paper::parse(text).ok_or_else(|| {
        format!("write {} or a size of 20 to 10000 mm such as 600x400mm", Paper::names().join(", "))
    })
}

/// Runs a subcommand.
pub(crate) fn run(command: &TargetCommand) -> Result<ExitCode, Failure> {
    let TargetCommand::Make(arguments) = command;
    make(arguments)
}

fn make(arguments: &MakeArguments) -> Result<ExitCode, Failure> {
    let path = &arguments.output;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let Some(stem) = name.strip_suffix(".svg").filter(|stem| !stem.is_empty()) else {
        let message = format!("{}: targets are written as SVG", path.display());
        return Err(Failure::new(Reason::Usage, message).with_hint("let the name of the file end in .svg"));
    };
    let only_points = || Failure::new(Reason::Usage, "a set of points has no drawing");
    let spec = boresight::target_spec(&arguments.target).ok_or_else(only_points)?;
    let print = print_of(arguments)?;
    let made = sheet(&arguments.target, &print, arguments.paper.as_ref(), &spec).map_err(|why| match why {
        NotDrawn::OnlyPoints => only_points(),
        NotDrawn::TooMany { points, most } => {
            let message = format!("{spec} has {points} points, and no more than {most} are drawn");
            Failure::new(Reason::Usage, message).with_hint("take fewer and larger squares")
        }
        NotDrawn::TooLarge { needed_mm: [width, height], paper } => {
            let [paper_width, paper_height] = paper.size_mm.map(significant_mm);
            let needed = format!("{} x {} mm", significant_mm(width), significant_mm(height));
            let message = format!(
                "{spec} needs {needed} with its margins, and {} has {paper_width} x {paper_height} mm",
                paper.name
            );
            Failure::new(Reason::Usage, message).with_hint(
                "take larger paper (--paper A2, or a size such as --paper 900x700mm), smaller squares or fewer of them",
            )
        }
    })?;
    let job = format!(
        "# {name}; measure the print before use, and write here what it measures.\n[target]\nkind = \"{spec}\"\n"
    );
    let job_name = format!("{stem}.toml");
    let folder = path.parent().unwrap_or(Path::new(""));
    let job_path = folder.join(&job_name);
    let job_path_shown = job_path.display();
    // What was measured may have been written there since.
    if std::fs::read(&job_path).is_ok_and(|there| there != job.as_bytes()) {
        let message = format!("{job_path_shown} is there already, and says something else");
        return Err(Failure::new(Reason::Usage, message).with_hint("name another file with -o, or remove it"));
    }
    let paper = format!("{}, {}", path.display(), paper_in_words(&made.paper));
    write_files(
        folder,
        &[
            OutputFile { name: name.clone(), bytes: made.svg.as_bytes().to_vec() },
            OutputFile { name: job_name, bytes: job.clone().into_bytes() },
        ],
    )?;
    answer(job.as_bytes())?;
    note(&format!("\nwritten: {paper}\nwritten: {job_path_shown}, its part of a job file\n"));
    note(&what_to_check(&arguments.target, &made));
    if let Some(hint) = upside_down(&arguments.target) {
        note(&hint);
    }
    note(&format!("next:    boresight calibrate IMAGES -c {job_path_shown}"));
    Ok(ExitCode::SUCCESS)
}

/// Returns what the arguments say of the print; what does not concern the target is refused.
fn print_of(arguments: &MakeArguments) -> Result<Print, Failure> {
    let geometry = &arguments.target.geometry;
    let idle = |flag: &str, of: &str| {
        Err(Failure::new(Reason::Usage, format!("{flag} is for {of}")).with_hint("leave it out"))
    };
    if arguments.first_square != SquareColour::Dark && !matches!(geometry, Geometry::Charuco { .. }) {
        return idle("--first-square", "ChArUco boards");
    }
    if arguments.tag_border != 2 && !matches!(geometry, Geometry::AprilGrid { .. }) {
        return idle("--tag-border", "AprilGrids");
    }
    let first_square = match arguments.first_square {
        SquareColour::Dark => FirstSquare::Dark,
        SquareColour::White => FirstSquare::White,
    };
    Ok(Print { first_square, tag_border: usize::from(arguments.tag_border), ..Print::default() })
}

/// Returns how a sheet lies and how large it is.
fn paper_in_words(paper: &Paper) -> String {
    let [width, height] = paper.size_mm;
    let how = if width > height { "landscape" } else { "portrait" };
    let (width, height) = (significant_mm(width), significant_mm(height));
    format!("{} {how} ({width} x {height} mm)", paper.name)
}

/// Returns what to measure on a print, and what to do with it.
fn what_to_check(target: &Target, made: &Sheet) -> String {
    let [width, height] = made.printed_mm.map(significant_mm);
    let edges = match target.geometry {
        Geometry::Circles { .. } => "from the outer edge of the first dot to that of the last",
        _ => "from the outer edge of the first square to that of the last",
    };
    format!(
        "print   at 100 % (actual size, no fitting to the page), matt, and glue it to something flat and stiff\n\
         check   the line below the target: {} mm from stroke to stroke\n\
         \x20       the target {edges}: {width} mm across, {height} mm down;\n\
         \x20       if these are off by the same share, write the size that you measure into the job file; if across and\n\
         \x20       down differ in their share, the printer stretches: print it on another one",
        significant_mm(made.ruler_mm)
    )
}

/// Returns what is to be known of a target that looks the same when turned by half.
fn upside_down(target: &Target) -> Option<String> {
    let [columns, rows] = target.geometry.grid()?;
    let is_symmetric = match &target.geometry {
        Geometry::Chessboard { .. } => (columns + rows).is_multiple_of(2),
        Geometry::Circles { layout, .. } => *layout == CircleLayout::Symmetric || rows.is_multiple_of(2),
        _ => false,
    };
    is_symmetric.then(|| {
        "note    it looks the same upside down: that is fine for one camera; for rigs and robots take a chessboard with an\n\
         \x20       odd sum of columns and rows, a ChArUco board or an AprilGrid"
            .to_owned()
    })
}

/// Returns a length in millimetres without zeros at its end.
fn significant_mm(mm: f64) -> String {
    let text = significant(mm);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}
