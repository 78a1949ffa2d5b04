//! The long text of each code that a finding may bear.

use crate::hand_eye::ROBOT_CODES;
use crate::line_delay::LINE_DELAY_TEXTS;
use crate::recording_texts::RECORDING_TEXTS;
use crate::robot_texts::TEXTS;
use crate::time_offset::TIME_OFFSET_TEXTS;

/// The codes of findings about the input, which are noticed while reading.
const OF_INPUT: &[(&str, &str)] = &[
    (
        "camera-without-views",
        "What it means: the job lists a camera of which no corner file has a single view.\n\n\
         Why it matters: the camera cannot be calibrated; it is absent from the result.\n\n\
         How to fix it: add its corner file to [input] corners of the job, check that the camera's name, or its\n\
         `images` pattern, matches the names in the file, or take the camera out of the job.",
    ),
    (
        "corners-at-minus-one",
        "What it means: some corners are at the pixel (-1, -1), by which some detectors say that a corner was\n\
         not found. They are taken as missing.\n\n\
         Why it matters: it does not, unless a corner was truly seen there, outside the image.\n\n\
         How to fix it: leave corners that were not found out of the file.",
    ),
    (
        "duplicate-images",
        "What it means: some images of a camera are copies of others, byte by byte. They are left out.\n\n\
         Why it matters: a copy adds no information, but would count as if it did: every sigma would come out too small.\n\n\
         How to fix it: take the copies away.",
    ),
    (
        "image-orientation",
        "What it means: the files ask, by EXIF, for the image to be turned or mirrored when it is shown. The pixels\n\
         are taken as they are stored.\n\n\
         Why it matters: a calibration holds for the pixels it was made from. A program that turns the image first sees\n\
         other pixels.\n\n\
         How to fix it: undistort and measure in images as they are stored, or store them turned and calibrate those.",
    ),
    (
        "images-without-camera",
        "What it means: a corner file names images that match the pattern (`images`) of no camera in the job.\n\
         Their corners are left out.\n\n\
         Why it matters: if they belong to a camera of the rig, their information is lost.\n\n\
         How to fix it: widen the pattern of the camera they belong to, or ignore this if they are of another\n\
         camera.",
    ),
    (
        "legacy-charuco",
        "What it means: the square in the first corner of the ChArUco board is white, as OpenCV before 4.6 drew boards with an\n\
         even number of rows. The markers told so, and the corners are labelled as on that board.\n\n\
         Why it matters: here it does not. A program that expects the current pattern, with a dark first square, finds no\n\
         corners on such a board, or labels them wrongly.\n\n\
         How to fix it: nothing needs to be done. Tell other programs which pattern it is (setLegacyPattern in OpenCV), or\n\
         print the board anew.",
    ),
    (
        "mixed-image-sizes",
        "What it means: some images of a camera have another size than most. They are left out.\n\n\
         Why it matters: a calibration holds for one size of image. Images of another size were scaled or cropped, or\n\
         are of another camera.\n\n\
         How to fix it: take them away, or calibrate them apart.",
    ),
    (
        "no-newline-at-end",
        "What it means: the last line of a file does not end in a newline.\n\n\
         Why it matters: a file whose writing or copying was cut off often looks like this, and the last number\n\
         may then be wrong.\n\n\
         How to fix it: compare the file with its source and copy it again; a newline at its end silences this.",
    ),
    (
        crate::doctor::NO_START,
        "What it means: lenses and poses could not even be estimated roughly, in closed form, from the views there are.\n\
         The message says what is missing.\n\n\
         Why it matters: a calibration begins with that estimate, so it would end with the same message.\n\n\
         How to fix it: take more views of a board that is tilted by 20 to 45 degrees to either side. Where there are\n\
         plenty, the board is another than declared: count inner corners, and check that rows and columns are not exchanged.",
    ),
    (
        "other-board-size",
        "What it means: in several images a board is seen that has another size than was declared, while at least as many\n\
         show the declared one. Where fewer do, no label is used and no calibration made: the error says how the board\n\
         that is seen is declared.\n\n\
         Why it matters: where its rim is out of the image, a part of another board looks like a part of the declared one,\n\
         and its corners would be labelled by the wrong end. Such views contradict each other by whole squares.\n\n\
         How to fix it: take the other board away or cover it. If it is the target, count the inner corners, where four\n\
         squares meet, along a row and along a column, and declare those.",
    ),
    (
        "pixels-outside-image",
        "What it means: some corners lie outside the image by more than a tenth of its size.\n\n\
         Why it matters: corners are detected inside the image, so image_size, or the camera that the corners\n\
         are given to, may be wrong.\n\n\
         How to fix it: check image_size of the camera, and that the corners were not detected in images that\n\
         were scaled or cropped otherwise.",
    ),
    (
        "target-not-detected",
        "What it means: the target was not detected in some images, for the reason that is told. A part of a board is\n\
         used where its labels are certain: where enough of the rim is seen to tell which part it is.\n\n\
         Why it matters: images without the target do no harm, but those of a target near the border of the image say most\n\
         about the lens there.\n\n\
         How to fix it: look at the images with boresight detect --overlays, keep a white rim around the squares, and let the\n\
         board's rim show on one side at least in each direction.",
    ),
    (
        "unreadable-image",
        "What it means: a file could not be read as an image. It is left out.\n\n\
         Why it matters: if it shows the target, its information is lost.\n\n\
         How to fix it: copy it again from its source, or take it away.",
    ),
];

/// All tables of codes with their long texts, beside those of `boresight-validate`.
const TABLES: [&[(&str, &str)]; 6] =
    [OF_INPUT, ROBOT_CODES, TEXTS, RECORDING_TEXTS, TIME_OFFSET_TEXTS, LINE_DELAY_TEXTS];

/// Returns the long text of a code: what it means, why it matters, how to fix it. `None` for an unknown code.
pub fn explain(code: &str) -> Option<&'static str> {
    let own = TABLES.into_iter().flatten().find(|(known, _)| *known == code);
    boresight_validate::explain(code).or(own.map(|(_, text)| *text))
}

/// Returns all codes in alphabetical order.
pub fn codes() -> Vec<&'static str> {
    let mut codes = boresight_validate::codes();
    codes.extend(TABLES.into_iter().flatten().map(|(code, _)| *code));
    codes.sort_unstable();
    codes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_its_text_once() {
        let codes = codes();
        assert!(codes.windows(2).all(|pair| pair[0] < pair[1]), "{codes:?}");
        for code in codes {
            let text = explain(code).unwrap();
            for heading in ["What it means: ", "Why it matters: ", "How to fix it: "] {
                assert_eq!(text.matches(heading).count(), 1, "{code}: {heading}");
            }
        }
        assert_eq!(explain("none-such"), None);
    }
}
