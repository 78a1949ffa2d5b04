//! A pose says both ends: `b_from_a`. Never a transformation that leaves its direction open.

use super::Finding;
use super::tree::{Tree, numbered};

/// Words that name a frame.
const FRAMES: &[&str] = &[
    "base",
    "board",
    "body",
    "cam",
    "camera",
    "first",
    "flange",
    "frame",
    "gripper",
    "hand",
    "imu",
    "lens",
    "object",
    "ref",
    "reference",
    "rig",
    "robot",
    "sensor",
    "target",
    "tip",
    "tool",
    "world",
];

const FIX: &str = "name both ends as b_from_a, such as cam_from_rig (docs/conventions.md)";

/// Finds names that do not say which way a pose leads.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, source) in &tree.rust {
        for (line, code) in numbered(&source.code) {
            for word in code.split(|c: char| !(c == '_' || c.is_alphanumeric())) {
                if let Some(why) = wrong(word) {
                    findings.push(Finding::new(file, line, format!("`{word}` {why}"), FIX));
                }
            }
            if let Some(field) = unnamed_pose(code) {
                findings.push(Finding::new(
                    file,
                    line,
                    format!("the pose `{field}` does not say both ends"),
                    FIX,
                ));
            }
        }
    }
    findings
}

fn wrong(word: &str) -> Option<&'static str> {
    if word.starts_with("T_") {
        return Some("is a transformation with a letter for a name");
    }
    let lower = word.to_lowercase();
    if lower.contains("extrinsic") {
        return Some("leaves the direction of the pose open");
    }
    let parts: Vec<&str> = lower.split('_').collect();
    let is_frame = |part: Option<&&str>| part.is_some_and(|part| FRAMES.contains(part));
    let between_frames = |joint: &str| {
        (1..parts.len())
            .any(|i| parts[i] == joint && is_frame(parts.get(i - 1)) && is_frame(parts.get(i + 1)))
    };
    if between_frames("to") || between_frames("se3") || between_frames("t") {
        return Some("reads backwards in a product");
    }
    None
}

/// Returns the name of a public field on this line that is a single pose and is not named for its ends.
fn unnamed_pose(code: &str) -> Option<&str> {
    let (name, kind) = code.trim().strip_prefix("pub ")?.split_once(": ")?;
    let is_pose = matches!(kind.trim_end_matches(','), "Pose" | "Option<Pose>");
    let is_field = name.chars().all(|c| c == '_' || c.is_alphanumeric());
    (is_pose && is_field && !name.contains("_from_")).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_without_a_direction_are_found() {
        for word in
            ["cam_to_rig", "T_cam_rig", "extrinsics", "EXTRINSIC", "cam_se3_rig", "my_rig_to_base_pose"]
        {
            assert!(wrong(word).is_some(), "{word}");
        }
        for word in ["cam_from_rig", "matrices_to_text", "T", "to_rig", "next_multiple_of", "TARGET"] {
            assert_eq!(wrong(word), None, "{word}");
        }
    }

    #[test]
    fn fields_that_are_poses_say_both_ends() {
        assert_eq!(unnamed_pose("    pub pose: Pose,"), Some("pose"));
        assert_eq!(unnamed_pose("    pub base_from_flange: Option<Pose>,"), None);
        assert_eq!(unnamed_pose("    pub poses: Vec<Pose>,"), None);
        assert_eq!(unnamed_pose("pub fn pose(&self) -> Pose {"), None);
    }

    #[test]
    fn comments_and_strings_may_say_anything() {
        let tree = Tree::of(&[("a.rs", "// extrinsics\nlet key = \"extrinsics\";\nlet T_a = 1;\n")]);
        let findings = check(&tree);
        assert_eq!(findings.iter().map(|finding| finding.line).collect::<Vec<_>>(), [3]);
    }
}
