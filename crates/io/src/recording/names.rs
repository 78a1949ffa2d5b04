//! Which camera a topic is of, told from the topics' names.
//!
//! The last parts of a topic's name that only say what kind of message it is (`image_raw`, `compressed`, `camera_info`)
//! are dropped, and so are leading parts that all topics share: of `/drone/left/image_raw` and `/drone/right/image_raw`
//! remain `left` and `right`.

use crate::Error;
use crate::image_names::{Listed, match_pattern};

/// Returns the camera of each topic by the names alone.
pub(crate) fn cameras_of_topics(topics: &[&str]) -> Vec<String> {
    let parts: Vec<Vec<&str>> = topics.iter().map(|topic| own_parts(topic)).collect();
    let shortest = parts.iter().map(Vec::len).min().unwrap_or(0);
    let Some(first) = parts.first() else { return Vec::new() };
    let shared = (0..shortest.saturating_sub(1))
        .take_while(|i| parts.iter().all(|parts| parts[*i] == first[*i]))
        .count();
    let name = |parts: &Vec<&str>| match parts[shared.min(parts.len())..].join("-") {
        name if name.is_empty() => "camera".to_owned(),
        name => name.replace(|c: char| c.is_control() || c == '\\', "_"),
    };
    parts.iter().map(name).collect()
}

/// Returns the parts of a topic's name that do not say what kind of message it is.
fn own_parts(topic: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = topic.split('/').filter(|part| !part.is_empty()).collect();
    while parts.last().is_some_and(|part| {
        part.starts_with("image") || ["compressed", "raw", "camera_info", "calibration"].contains(part)
    }) {
        parts.pop();
    }
    parts
}

/// Returns the camera of each image topic, or `None` where it is of no camera that the job lists.
pub(crate) fn assign_topics(topics: &[&str], listed: &[Listed]) -> Result<Vec<Option<String>>, Error> {
    let by_name = cameras_of_topics(topics);
    if listed.is_empty() {
        return Ok(by_name.into_iter().map(Some).collect());
    }
    let ambiguous = |why: String| Error::AmbiguousNames { file: "the recording".to_owned(), why };
    let mut taken = Vec::new();
    for (topic, name) in topics.iter().zip(&by_name) {
        let is_of = |camera: &&Listed| match &camera.images {
            Some(pattern) => match_pattern(pattern, topic).is_some(),
            None => camera.name == *name || topic.split('/').any(|part| part == camera.name),
        };
        let mut cameras = listed.iter().filter(is_of);
        let camera = cameras.next();
        if let (Some(first), Some(second)) = (camera, cameras.next()) {
            return Err(ambiguous(format!("{topic} may be of {} or of {}", first.name, second.name)));
        }
        taken.push(camera.map(|camera| camera.name.clone()));
    }
    if taken.iter().all(Option::is_none) {
        if let ([_], [only]) = (topics, listed) {
            return Ok(vec![Some(only.name.clone())]);
        }
        let names: Vec<&str> = listed.iter().map(|camera| camera.name.as_str()).collect();
        let why = format!("no topic of {} is of the cameras {}", topics.join(", "), names.join(", "));
        return Err(ambiguous(why));
    }
    Ok(taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(cameras: &[(&str, Option<&str>)]) -> Vec<Listed> {
        let listed = |(name, images): &(&str, Option<&str>)| Listed {
            name: (*name).to_owned(),
            images: images.map(str::to_owned),
        };
        cameras.iter().map(listed).collect()
    }

    #[test]
    fn topics_are_named_by_what_is_their_own() {
        let names = |topics: &[&str]| cameras_of_topics(topics).join(" ");
        assert_eq!(names(&["/drone/left/image_raw", "/drone/right/image_raw/compressed"]), "left right");
        assert_eq!(names(&["/cam0/image_raw"]), "cam0");
        assert_eq!(names(&["/image_raw"]), "camera");
        assert_eq!(names(&["/rig/color/image_raw", "/rig/infra/1/image_rect"]), "color infra-1");
        assert_eq!(names(&["/a/image", "/a/image/compressed"]), "a a");
        assert_eq!(names(&["/a/x/image", "/image"]), "a-x camera");
        assert_eq!(names(&[]), "");
    }

    #[test]
    fn cameras_that_are_listed_take_their_topics() {
        let topics = ["/drone/left/image_raw", "/drone/right/image_raw"];
        let assigned = |cameras: &[(&str, Option<&str>)]| assign_topics(&topics, &listed(cameras));
        let names = |names: [Option<&str>; 2]| names.map(|name| name.map(str::to_owned)).to_vec();
        assert_eq!(assigned(&[]).unwrap(), names([Some("left"), Some("right")]));
        assert_eq!(assigned(&[("right", None)]).unwrap(), names([None, Some("right")]));
        assert_eq!(assigned(&[("a", Some("*/left/*"))]).unwrap(), names([Some("a"), None]));
        assert!(assigned(&[("a", Some("*left*")), ("b", Some("*"))]).is_err());
        assert!(assigned(&[("a", None), ("b", None)]).is_err());
        assert_eq!(assign_topics(&["/x"], &listed(&[("a", None)])).unwrap(), [Some("a".to_owned())]);
    }
}
