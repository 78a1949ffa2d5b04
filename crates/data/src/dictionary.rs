//! The dictionaries of square markers that boards are printed with.

use std::fmt;
use std::sync::LazyLock;

/// A dictionary of square black and white markers, such as `5x5_1000`.
///
/// The names are OpenCV's without `DICT_`; those of AprilTag's families are the families'.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Dictionary(u8);

struct Entry {
    name: &'static str,
    /// Its table in `markers.txt`, of which it is the beginning.
    table: &'static str,
    count: usize,
    /// How many wrong bits leave a marker nearer to its own code than to any other.
    correctable: u32,
}

const fn entry(name: &'static str, table: &'static str, count: usize, correctable: u32) -> Entry {
    Entry { name, table, count, correctable }
}

const ENTRIES: [Entry; 20] = [
    entry("4x4_50", "4x4", 50, 1),
    entry("4x4_100", "4x4", 100, 1),
    entry("4x4_250", "4x4", 250, 1),
    entry("4x4_1000", "4x4", 1000, 0),
    entry("5x5_50", "5x5", 50, 3),
    entry("5x5_100", "5x5", 100, 3),
    entry("5x5_250", "5x5", 250, 2),
    entry("5x5_1000", "5x5", 1000, 2),
    entry("6x6_50", "6x6", 50, 6),
    entry("6x6_100", "6x6", 100, 5),
    entry("6x6_250", "6x6", 250, 5),
    entry("6x6_1000", "6x6", 1000, 4),
    entry("7x7_50", "7x7", 50, 9),
    entry("7x7_100", "7x7", 100, 8),
    entry("7x7_250", "7x7", 250, 8),
    entry("7x7_1000", "7x7", 1000, 6),
    // Some of the original's markers are others turned by a half.
    entry("original", "original", 1024, 0),
    entry("16h5", "16h5", 30, 2),
    entry("25h9", "25h9", 35, 4),
    entry("36h11", "36h11", 587, 5),
];

impl Dictionary {
    /// AprilTag's family of 36 bits, which Kalibr's grids use.
    pub const APRILTAG_36H11: Dictionary = Dictionary(19);

    /// Returns all dictionaries, the smaller ones of a size first.
    pub fn all() -> impl DoubleEndedIterator<Item = Dictionary> {
        (0..ENTRIES.len()).map(|i| Dictionary(i as u8))
    }

    /// Returns the dictionary of this name, or `None`; `DICT_`, `APRILTAG_`, `aruco_`, `t` before it are passed over.
    pub fn named(name: &str) -> Option<Self> {
        let lower = name.to_ascii_lowercase();
        let bare = ["dict_", "apriltag_", "aruco_", "tag", "t"]
            .iter()
            .fold(lower.as_str(), |name, prefix| name.strip_prefix(prefix).unwrap_or(name));
        Self::all().find(|dictionary| dictionary.name() == bare)
    }

    /// Returns the name, such as `5x5_1000` or `36h11`.
    pub fn name(self) -> &'static str {
        self.entry().name
    }

    /// Returns how many bits a marker has along a side, without its border.
    pub fn bits_across(self) -> usize {
        self.table().0
    }

    /// Returns how many wrong bits leave a marker nearer to its own code than to any other.
    pub fn correctable_bits(self) -> u32 {
        self.entry().correctable
    }

    /// Returns the codes by id: row by row from the top left, the first bit the highest, 1 is white.
    pub fn codes(self) -> &'static [u64] {
        &self.table().1[..self.entry().count]
    }

    fn entry(self) -> &'static Entry {
        &ENTRIES[usize::from(self.0)]
    }

    fn table(self) -> &'static (usize, Vec<u64>) {
        let of_name = TABLES.iter().find(|(name, _)| *name == self.entry().table);
        &of_name.expect("every dictionary has its table").1
    }
}

impl fmt::Debug for Dictionary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Name, bits along a side, and codes of each table.
type Tables = Vec<(&'static str, (usize, Vec<u64>))>;

static TABLES: LazyLock<Tables> = LazyLock::new(|| {
    let mut tables: Tables = Vec::new();
    for line in include_str!("markers.txt").lines().filter(|line| !line.starts_with('#')) {
        let is_head = tables.is_empty() || line.split_once(' ').is_some_and(|(name, _)| is_table(name));
        if is_head {
            let (name, side) = line.split_once(' ').expect("a head is a name and a number");
            tables.push((name, (side.parse().expect("bits along a side"), Vec::new())));
        } else if let Some((_, (_, codes))) = tables.last_mut() {
            let code = |word| u64::from_str_radix(word, 16).expect("codes are hexadecimal");
            codes.extend(line.split(' ').map(code));
        }
    }
    tables
});

fn is_table(name: &str) -> bool {
    ENTRIES.iter().any(|entry| entry.table == name)
}

/// Returns the code of a marker of `side` bits along a side, turned by a quarter from +x towards +y (clockwise).
pub fn quarter_turned(code: u64, side: usize) -> u64 {
    let bit = |x: usize, y: usize| code >> (side * side - 1 - (y * side + x)) & 1;
    let mut turned = 0;
    for y in 0..side {
        for x in 0..side {
            // What was at the left bottom comes to the left top.
            turned = turned << 1 | bit(y, side - 1 - x);
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_dictionaries_have_their_codes() {
        for (name, side, first) in
            [("4x4_50", 4, 0b1011_0101_0011_0010), ("36h11", 6, 0b001000_011010_000101_000110_101110_101011)]
        {
            let dictionary = Dictionary::named(name).unwrap();
            assert_eq!((dictionary.bits_across(), dictionary.codes()[0]), (side, first), "{name}");
        }
        for dictionary in Dictionary::all() {
            let (side, codes) = (dictionary.bits_across(), dictionary.codes());
            assert_eq!(codes.len(), dictionary.entry().count);
            assert!(codes.iter().all(|code| code >> (side * side) == 0), "{dictionary:?}");
        }
        assert_eq!(Dictionary::APRILTAG_36H11.name(), "36h11");
        for name in ["DICT_5X5_1000", "5x5_1000"] {
            assert_eq!(Dictionary::named(name).unwrap().name(), "5x5_1000");
        }
        for name in ["DICT_APRILTAG_36h11", "t36h11", "tag36h11"] {
            assert_eq!(Dictionary::named(name), Some(Dictionary::APRILTAG_36H11));
        }
        assert_eq!(Dictionary::named("8x8_50"), None);
    }

    #[test]
    fn corrections_are_what_the_codes_allow() {
        for dictionary in Dictionary::all().filter(|dictionary| dictionary.codes().len() <= 250) {
            let (side, codes) = (dictionary.bits_across(), dictionary.codes());
            let mut least = u32::MAX;
            for (i, &code) in codes.iter().enumerate() {
                let mut turned = code;
                for quarters in 0..4 {
                    let others = codes.iter().enumerate().filter(|(j, _)| *j != i || quarters != 0);
                    least = others.map(|(_, other)| (turned ^ other).count_ones()).fold(least, u32::min);
                    turned = quarter_turned(turned, side);
                }
                assert_eq!(turned, code);
            }
            assert!(2 * dictionary.correctable_bits() < least, "{dictionary:?}: {least}");
        }
    }

    #[test]
    fn a_quarter_turn_is_clockwise() {
        // 1 0     0 1
        // 0 0 ->  0 0
        assert_eq!(quarter_turned(0b1000, 2), 0b0100);
        assert_eq!(quarter_turned(0b110_000_100, 3), 0b101_001_000);
    }
}
