//! Which camera took an image, and in which frame, told from the image's name.
//!
//! The first rule that applies decides, for all images of a file at once:
//! 1. **Patterns.** The job gives cameras a pattern, `images = "left*.jpg"`: an image is of the camera
//!    whose pattern it matches (`*` any text, `?` any character; against the whole name, or its last part
//!    where the pattern has no `/`), and what the wildcards match names the frame. Images that match
//!    no pattern are left out.
//! 2. **One camera.** The job lists one camera: all images are its own, each a frame.
//! 3. **Names.** The job lists several cameras, and every image name holds the name of exactly one
//!    (`left01.jpg`, `cam0/0001.png`, `frame00012-cam3.jpg`): the rest of the name names the frame.
//! 4. **Structure.** No cameras are listed: images whose folders, or else whose names without their
//!    numbers, are equal are of one camera. Where they are all equal, a number that follows `cam` or
//!    `camera` tells the camera; otherwise there is one camera.
//!
//! In rules 3 and 4 the frame is the numbers of the rest where they tell all images of a camera apart,
//! and else the whole rest. Frames of several cameras whose numbers differ in leading zeros only (`1`, `001`) are one.
//! Anything else is ambiguous: an error that asks for patterns.

use std::collections::{BTreeMap, BTreeSet};

use crate::Error;

/// A camera that the job lists.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Listed {
    /// Its name.
    pub name: String,
    /// The pattern of its images' names, where one is given.
    pub images: Option<String>,
}

/// The camera and the frame of an image.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Taken {
    /// The camera's name.
    pub camera: String,
    /// The frame's name.
    pub frame: String,
}

/// Returns who took each image of `file` and when; `None` for one that matches no camera's pattern.
pub(crate) fn assign(file: &str, images: &[&str], listed: &[Listed]) -> Result<Vec<Option<Taken>>, Error> {
    let ambiguous = |why: String| Error::AmbiguousNames { file: file.to_owned(), why };
    if listed.iter().any(|camera| camera.images.is_some()) {
        return by_pattern(images, listed).map(alike).map_err(ambiguous);
    }
    let halves = match listed {
        [] => by_structure(images).map_err(ambiguous)?,
        [only] => {
            images.iter().map(|image| (only.name.clone(), without_extension(image).to_owned())).collect()
        }
        several => by_name(images, several).map_err(ambiguous)?,
    };
    let taken = if listed.len() == 1 { named(halves, str::to_owned) } else { with_frames(halves) };
    Ok(alike(taken.into_iter().map(Some).collect()))
}

/// Gives frames one name whose names differ in leading zeros only, `1` in one camera and `001` in another: the longest.
///
/// Where one camera has both, zeros tell frames apart, and all names stay.
fn alike(taken: Vec<Option<Taken>>) -> Vec<Option<Taken>> {
    let mut longest: BTreeMap<String, String> = BTreeMap::new();
    let mut of_cameras: BTreeSet<(String, String)> = BTreeSet::new();
    let mut keeps_zeros = false;
    for Taken { camera, frame } in taken.iter().flatten().collect::<BTreeSet<&Taken>>() {
        let number = without_leading_zeros(frame);
        keeps_zeros |= !of_cameras.insert((camera.clone(), number.clone()));
        let known = longest.entry(number).or_default();
        if frame.len() > known.len() {
            known.clone_from(frame);
        }
    }
    if keeps_zeros {
        return taken;
    }
    let renamed = |Taken { camera, frame }: Taken| {
        let frame = longest.get(&without_leading_zeros(&frame)).cloned().unwrap_or(frame);
        Taken { camera, frame }
    };
    taken.into_iter().map(|taken| taken.map(renamed)).collect()
}

/// Returns a text with one number without the zeros that this begins with; one with several numbers, which may be the
/// decimals of a time, as it is.
fn without_leading_zeros(text: &str) -> String {
    let [number] = numbers(text)[..] else { return text.to_owned() };
    let short = number.trim_start_matches('0');
    text.replacen(number, if short.is_empty() { "0" } else { short }, 1)
}

fn named(halves: Vec<(String, String)>, frame: impl Fn(&str) -> String) -> Vec<Taken> {
    halves.into_iter().map(|(camera, rest)| Taken { camera, frame: frame(&rest) }).collect()
}

/// Turns the rest of each name into a frame's name.
fn with_frames(halves: Vec<(String, String)>) -> Vec<Taken> {
    let whole = |rest: &str| {
        let trimmed = without_extension(rest).trim_matches(|c| "-_./ ".contains(c));
        if trimmed.is_empty() { rest.to_owned() } else { trimmed.to_owned() }
    };
    // An image without a number, such as a picture of the rig, is no reason to pair the others otherwise.
    let by_numbers = named(halves.clone(), |rest| {
        let number = numbers(rest).join("-");
        if number.is_empty() { whole(rest) } else { number }
    });
    let distinct: BTreeSet<&Taken> = by_numbers.iter().collect();
    if distinct.len() == by_numbers.len() { by_numbers } else { named(halves, whole) }
}

fn by_pattern(images: &[&str], listed: &[Listed]) -> Result<Vec<Option<Taken>>, String> {
    if let Some(camera) = listed.iter().find(|camera| camera.images.is_none()) {
        return Err(format!("camera {} has no pattern, others have", camera.name));
    }
    let take = |image: &&str| {
        let mut taken: Option<Taken> = None;
        for camera in listed {
            let pattern = camera.images.as_deref().unwrap_or_default();
            let subject = if pattern.contains('/') { image } else { last_part(image) };
            let Some(parts) = match_pattern(pattern, subject) else { continue };
            if let Some(other) = taken {
                return Err(format!(
                    "{image} matches the patterns of {} and of {}",
                    other.camera, camera.name
                ));
            }
            let frame = if parts.is_empty() { without_extension(image).to_owned() } else { parts.join("-") };
            taken = Some(Taken { camera: camera.name.clone(), frame });
        }
        Ok(taken)
    };
    let taken: Vec<Option<Taken>> = images.iter().map(take).collect::<Result<_, _>>()?;
    if let (Some(first), true) = (images.first(), taken.iter().all(Option::is_none)) {
        let patterns: Vec<&str> = listed.iter().filter_map(|camera| camera.images.as_deref()).collect();
        return Err(format!(
            "no image matches any of the patterns {}; the first is {first}",
            patterns.join(", ")
        ));
    }
    Ok(taken)
}

fn by_name(images: &[&str], listed: &[Listed]) -> Result<Vec<(String, String)>, String> {
    let names = || listed.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>().join(", ");
    images
        .iter()
        .map(|image| {
            let mut found: Option<(&str, String)> = None;
            for camera in listed {
                let Some(rest) = remove_word(image, &camera.name) else { continue };
                if let Some((other, _)) = found {
                    return Err(format!(
                        "{image} holds the names of the cameras {other} and {}",
                        camera.name
                    ));
                }
                found = Some((&camera.name, rest));
            }
            let (camera, rest) =
                found.ok_or_else(|| format!("{image} holds the name of none of the cameras {}", names()))?;
            Ok((camera.to_owned(), rest))
        })
        .collect()
}

fn by_structure(images: &[&str]) -> Result<Vec<(String, String)>, String> {
    let distinct = |key: &dyn Fn(&str) -> String| -> usize {
        images.iter().map(|image| key(image)).collect::<BTreeSet<_>>().len()
    };
    let folder = |image: &str| image.rsplit_once('/').map_or("", |(folder, _)| folder).to_owned();
    let camera_number = |image: &str| number_after_camera(image).map(|(_, number)| number.to_owned());
    if distinct(&folder) > 1 {
        let common = common_folders(images);
        let split = |image: &&str| {
            let (folder, name) = image.rsplit_once('/').unwrap_or(("", image));
            let camera = folder.split('/').skip(common).collect::<Vec<_>>().join("/");
            (if camera.is_empty() { "camera".to_owned() } else { camera }, name.to_owned())
        };
        let halves: Vec<_> = images.iter().map(split).collect();
        let cameras: BTreeSet<&str> = halves.iter().map(|(camera, _)| camera.as_str()).collect();
        if cameras.len() * 2 > images.len() {
            let why =
                format!("{} folders hold {} images, so a folder is no camera", cameras.len(), images.len());
            return Err(why);
        }
        return Ok(halves);
    }
    if images.iter().all(|image| camera_number(last_part(image)).is_some()) {
        let split = |image: &&str| {
            let name = last_part(image);
            let (range, number) = number_after_camera(name).unwrap_or((0..0, ""));
            (format!("cam{number}"), format!("{}{}", &name[..range.start], &name[range.end..]))
        };
        return Ok(images.iter().map(split).collect());
    }
    let skeleton = |image: &str| without_numbers(without_extension(last_part(image)));
    if distinct(&skeleton) > 1 {
        if distinct(&skeleton) * 2 > images.len() {
            let (a, b) = (images.first().unwrap_or(&""), images.last().unwrap_or(&""));
            return Err(format!("names such as {a} and {b} share no structure"));
        }
        let camera = |image: &str| skeleton(image).trim_matches(|c| "#-_ ".contains(c)).replace('#', "");
        return Ok(images.iter().map(|image| (camera(image), last_part(image).to_owned())).collect());
    }
    let counts = varying_numbers(images);
    if counts > 1 {
        let example = images.first().unwrap_or(&"");
        return Err(format!(
            "{counts} numbers vary in names such as {example}: which of them is the camera?"
        ));
    }
    Ok(images.iter().map(|image| ("camera".to_owned(), last_part(image).to_owned())).collect())
}

/// Returns how many leading folders all images share.
fn common_folders(images: &[&str]) -> usize {
    let folders = |image: &str| -> Vec<String> {
        image
            .rsplit_once('/')
            .map_or(Vec::new(), |(folder, _)| folder.split('/').map(str::to_owned).collect())
    };
    let Some(first) = images.first().map(|image| folders(image)) else { return 0 };
    images.iter().fold(first.len(), |common, image| {
        folders(image).iter().zip(&first).take(common).take_while(|(a, b)| a == b).count()
    })
}

/// Returns how many of the numbers in names of one structure are not the same in all of them.
fn varying_numbers(images: &[&str]) -> usize {
    let mut values: BTreeMap<usize, BTreeSet<&str>> = BTreeMap::new();
    for image in images {
        for (i, number) in numbers(without_extension(last_part(image))).into_iter().enumerate() {
            values.entry(i).or_default().insert(number);
        }
    }
    values.values().filter(|values| values.len() > 1).count()
}

/// Returns the runs of digits in a text.
fn numbers(text: &str) -> Vec<&str> {
    text.split(|c: char| !c.is_ascii_digit()).filter(|run| !run.is_empty()).collect()
}

/// Returns a text with `#` for each run of digits.
fn without_numbers(text: &str) -> String {
    let mut skeleton = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '0'..='9' if skeleton.ends_with('#') => {}
            '0'..='9' => skeleton.push('#'),
            c => skeleton.push(c),
        }
    }
    skeleton
}

/// Returns `text` without the word, or `None` if it does not hold it.
///
/// A word that ends in a letter may be followed by a digit but not by a letter, and so on.
fn remove_word(text: &str, word: &str) -> Option<String> {
    let kind = |c: char| (c.is_alphabetic(), c.is_ascii_digit());
    let joins = |a: Option<char>, b: Option<char>| match (a, b) {
        (Some(a), Some(b)) => kind(a) == kind(b) && kind(a) != (false, false),
        _ => false,
    };
    if word.is_empty() {
        return None;
    }
    let (mut rest, mut from, mut found) = (String::new(), 0, false);
    for (at, _) in text.match_indices(word) {
        let (before, after) = (&text[..at], &text[at + word.len()..]);
        let apart = !joins(before.chars().next_back(), word.chars().next())
            && !joins(word.chars().next_back(), after.chars().next());
        if apart {
            rest.push_str(&text[from..at]);
            from = at + word.len();
            found = true;
        }
    }
    rest.push_str(&text[from..]);
    found.then_some(rest)
}

/// Returns the number that follows `cam` or `camera`, and where word and number are.
fn number_after_camera(name: &str) -> Option<(std::ops::Range<usize>, &str)> {
    let lower = name.to_ascii_lowercase();
    ["camera", "cam"].into_iter().find_map(|word| {
        let start = lower.find(word)?;
        let rest = &name[start + word.len()..];
        let skipped = rest.len() - rest.trim_start_matches(['-', '_']).len();
        let digits = rest[skipped..].bytes().take_while(u8::is_ascii_digit).count();
        let from = start + word.len() + skipped;
        (digits > 0).then(|| (start..from + digits, &name[from..from + digits]))
    })
}

/// Returns what the wildcards of `pattern` match in `text`, or `None` if it does not match.
///
/// A run of `?` gives one part; `*` takes as little as it can, in linear memory and quadratic time.
pub(crate) fn match_pattern<'a>(pattern: &str, text: &'a str) -> Option<Vec<&'a str>> {
    let pieces: Vec<&str> = pattern.split('*').collect();
    let fits = |piece: &str, text: &str| -> Option<usize> {
        let mut chars = text.char_indices();
        for wanted in piece.chars() {
            let (_, found) = chars.next()?;
            if wanted != '?' && wanted != found {
                return None;
            }
        }
        Some(chars.next().map_or(text.len(), |(at, _)| at))
    };
    let (first, last) = (pieces.first()?, pieces.last()?);
    let mut at = fits(first, text)?;
    let mut parts = Vec::new();
    let question_marks = |piece: &str, start: usize, parts: &mut Vec<&'a str>| {
        let mut chars = text[start..].char_indices().zip(piece.chars()).peekable();
        while let Some(((from, _), wanted)) = chars.next() {
            if wanted != '?' {
                continue;
            }
            let mut to = from + text[start + from..].chars().next().map_or(0, char::len_utf8);
            while let Some(((next, c), _)) = chars.next_if(|(_, wanted)| *wanted == '?') {
                to = next + c.len_utf8();
            }
            parts.push(&text[start + from..start + to]);
        }
    };
    question_marks(first, 0, &mut parts);
    if pieces.len() == 1 {
        return (at == text.len()).then_some(parts);
    }
    for piece in &pieces[1..pieces.len() - 1] {
        let (start, length) = text[at..]
            .char_indices()
            .find_map(|(offset, _)| fits(piece, &text[at + offset..]).map(|length| (at + offset, length)))?;
        parts.push(&text[at..start]);
        question_marks(piece, start, &mut parts);
        at = start + length;
    }
    let n_last = last.chars().count();
    let start = if n_last == 0 { text.len() } else { text.char_indices().rev().nth(n_last - 1)?.0 };
    (start >= at && fits(last, &text[start..]) == Some(text.len() - start)).then(|| {
        parts.push(&text[at..start]);
        question_marks(last, start, &mut parts);
        parts
    })
}

fn last_part(image: &str) -> &str {
    image.rsplit(['/', '\\']).next().unwrap_or(image)
}

fn without_extension(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, extension)) if !stem.is_empty() && !extension.contains('/') => stem,
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(names: &[&str]) -> Vec<Listed> {
        let split = |name: &&str| match name.split_once('=') {
            Some((name, images)) => Listed { name: name.to_owned(), images: Some(images.to_owned()) },
            None => Listed { name: (*name).to_owned(), images: None },
        };
        names.iter().map(split).collect()
    }

    fn check(images: &str, cameras: &[&str], expected: &str) {
        let images: Vec<&str> = images.split_whitespace().collect();
        let found = match assign("c.vnl", &images, &listed(cameras)) {
            Ok(taken) => taken
                .iter()
                .map(|taken| taken.as_ref().map_or("-".to_owned(), |t| format!("{}:{}", t.camera, t.frame)))
                .collect::<Vec<_>>()
                .join(" "),
            Err(error) => error.to_string(),
        };
        let as_error = expected.strip_prefix("error ");
        match as_error {
            Some(part) => assert!(found.contains(part), "`{part}` is not in: {found}"),
            None => assert_eq!(found, expected),
        }
    }

    #[test]
    fn patterns_tell_camera_and_frame() {
        check("0_000.png 0_001.png x.png", &["l=*_000.png", "r=*_001.png"], "l:0 r:0 -");
        check("a/c0/12.png a/c1/12.png", &["l=*c0/*.png", "r=*c1/??.png"], "l:a/-12 r:a/-12");
        check("here/left01.jpg", &["l=left*.jpg"], "l:01");
        check("1.png", &["l=*", "r=*.png"], "error 1.png matches the patterns of l and of r");
        check("1.png", &["l=*", "r"], "error camera r has no pattern");
        check("1.png", &["l=left*"], "error no image matches any of the patterns left*");
    }

    #[test]
    fn names_of_listed_cameras_are_found() {
        check("left01.jpg right01.jpg left02.jpg", &["left", "right"], "left:01 right:01 left:02");
        check("left/left1.jpg right/right1.jpg", &["left", "right"], "left:1 right:1");
        check("frame00012-cam3.png frame00012-cam10.png", &["cam10", "cam3"], "cam3:00012 cam10:00012");
        check("cam0/0001.png cam1/0001.png", &["cam0", "cam1"], "cam0:0001 cam1:0001");
        check("left_a.png left_b.png right_a.png", &["left", "right"], "left:a left:b right:a");
        check("a/x1-left.png b/x1-left.png right.png", &["left", "right"], "left:a/x1 left:b/x1 right:png");
        check(
            "left01.jpg bright01.jpg",
            &["left", "right"],
            "error bright01.jpg holds the name of none of the cameras",
        );
        check("left-right.jpg", &["left", "right"], "error left-right.jpg holds the names of");
        check("3.png 4.png", &["only"], "only:3 only:4");
    }

    #[test]
    fn leading_zeros_part_no_frames() {
        let two = "cam0/1.jpg cam0/2.jpg cam0/10.jpg cam1/001.jpg cam1/002.jpg cam1/010.jpg";
        let expected = "cam0:001 cam0:002 cam0:010 cam1:001 cam1:002 cam1:010";
        check(two, &[], expected);
        check(two, &["cam0", "cam1"], expected);
        check("cam0/1.jpg cam1/001.jpg", &["a=cam0/*.jpg", "b=cam1/*.jpg"], "a:001 b:001");
        // One camera has both: they are two frames.
        check("l1.jpg l01.jpg r01.jpg", &["l=l*.jpg", "r=r*.jpg"], "l:1 l:01 r:01");
        // Decimals of a time.
        check("l1.05.jpg r1.5.jpg", &["l=l*.jpg", "r=r*.jpg"], "l:1.05 r:1.5");
        check("0.png 00.png", &["only"], "only:0 only:00");
    }

    #[test]
    fn structure_tells_where_no_camera_is_listed() {
        check("left01.jpg left02.jpg right01.jpg right02.jpg", &[], "left:01 left:02 right:01 right:02");
        check("d/cam0/1.png d/cam0/2.png d/cam1/1.png d/cam1/2.png", &[], "cam0:1 cam0:2 cam1:1 cam1:2");
        check("frame12-cam3.png frame12-cam4.png", &[], "cam3:12 cam4:12");
        check("img1.png img10.png", &[], "camera:1 camera:10");
        check(
            "2024-05-07T080500.jpg 2024-05-07T080501.jpg",
            &[],
            "camera:2024-05-07-080500 camera:2024-05-07-080501",
        );
        check(
            "000_000.png 000_001.png 001_000.png",
            &[],
            "error 2 numbers vary in names such as 000_000.png",
        );
        check("apple.png pear.png", &[], "error share no structure");
        check("1/a.png 2/b.png", &[], "error a folder is no camera");
    }

    #[test]
    fn patterns_match_as_in_a_shell() {
        for (pattern, text, expected) in [
            ("*", "", Some(vec![""])),
            ("a*", "a", Some(vec![""])),
            ("*b", "aabb", Some(vec!["aab"])),
            ("a*b*c", "axbyc", Some(vec!["x", "y"])),
            ("a??c", "axyc", Some(vec!["xy"])),
            ("ü?*", "üäb", Some(vec!["ä", "b"])),
            ("a*a", "a", None),
            ("abc", "abcd", None),
            ("", "", Some(vec![])),
        ] {
            assert_eq!(match_pattern(pattern, text), expected, "{pattern} {text}");
        }
    }
}
