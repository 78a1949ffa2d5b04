//! Sizes of paper.

/// Papers by name, with the shorter and the longer side in millimetres.
const PAPERS: [(&str, [f64; 2]); 8] = [
    ("a4", [210.0, 297.0]),
    ("a3", [297.0, 420.0]),
    ("a2", [420.0, 594.0]),
    ("a1", [594.0, 841.0]),
    ("a0", [841.0, 1189.0]),
    ("letter", [215.9, 279.4]),
    ("legal", [215.9, 355.6]),
    ("tabloid", [279.4, 431.8]),
];
/// As many of these, from the first on, are tried where no paper is named.
const N_TRIED: usize = 5;
/// The sides of sheets that are believed, in millimetres.
const SIDES_MM: std::ops::RangeInclusive<f64> = 20.0..=10_000.0;

/// A sheet of paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Paper {
    /// The name, such as `A4` or `300x200mm`.
    pub name: String,
    /// Both sides in millimetres, in any order: a sheet may be turned.
    pub size_mm: [f64; 2],
}

impl Paper {
    /// Returns the paper of a name, or of a size such as `600x400mm`; `None` if it is neither.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        if let Some((name, size_mm)) = PAPERS.iter().find(|(name, _)| text.eq_ignore_ascii_case(name)) {
            return Some(Self { name: shown(name), size_mm: *size_mm });
        }
        let (width, height) = text.strip_suffix("mm")?.split_once(['x', 'X', '×'])?;
        let side = |text: &str| text.trim().parse::<f64>().ok().filter(|side| SIDES_MM.contains(side));
        Some(Self { name: text.to_owned(), size_mm: [side(width)?, side(height)?] })
    }

    /// Returns the papers that have names, by name.
    pub fn names() -> Vec<String> {
        PAPERS.iter().map(|(name, _)| shown(name)).collect()
    }

    /// Returns the papers that are tried in turn where none is named: A4 to A0.
    pub fn tried() -> impl Iterator<Item = Self> {
        PAPERS[..N_TRIED].iter().map(|(name, size_mm)| Self { name: shown(name), size_mm: *size_mm })
    }
}

/// Returns a name as people write it.
fn shown(name: &str) -> String {
    if name.starts_with('a') { name.to_uppercase() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_sizes_are_read() {
        let size = |text: &str| Paper::parse(text).map(|paper| paper.size_mm);
        assert_eq!(size("a4"), Some([210.0, 297.0]));
        assert_eq!(size("Letter"), Some([215.9, 279.4]));
        assert_eq!(size("300x200.5mm"), Some([300.0, 200.5]));
        for text in ["", "a9", "300x200", "300mm", "x200mm", "0x200mm", "nanx20mm", "1e9x20mm"] {
            assert_eq!(size(text), None, "{text}");
        }
        assert_eq!(
            Paper::tried().map(|paper| paper.name).collect::<Vec<_>>(),
            ["A4", "A3", "A2", "A1", "A0"]
        );
        assert!(
            Paper::names().iter().all(|name| Paper::parse(name).is_some_and(|paper| paper.name == *name))
        );
    }
}
