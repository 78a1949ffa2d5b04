//! Cameras that share one lens: which they are, and what is told of that lens.

use boresight_camera::Camera;
use boresight_data::{CameraId, Dataset};

use crate::error::Error;

/// Cameras that share one lens, in the order of the dataset.
pub(crate) type Group = Vec<CameraId>;

/// Returns the groups of cameras that share a lens, from texts such as `left+right`; groups with a common camera
/// are one.
pub(crate) fn groups(dataset: &Dataset, texts: &[String]) -> Result<Vec<Group>, Error> {
    let mut groups: Vec<Group> = Vec::new();
    for text in texts {
        let mut group =
            text.split('+').map(|name| camera_of(dataset, name)).collect::<Result<Group, Error>>()?;
        let (common, mut others): (Vec<Group>, Vec<Group>) =
            groups.into_iter().partition(|known| known.iter().any(|camera| group.contains(camera)));
        group.extend(common.into_iter().flatten());
        group.sort_unstable();
        group.dedup();
        let size = |camera: CameraId| dataset.cameras[camera].image_size;
        if let Some(&other) = group.iter().find(|camera| size(**camera) != size(group[0])) {
            let [[width, height], [other_width, other_height]] = [size(group[0]), size(other)];
            let why = format!("the images are {width}x{height} and {other_width}x{other_height}");
            return Err(apart(dataset, [group[0], other], why));
        }
        others.push(group);
        groups = others;
    }
    Ok(groups)
}

/// Returns the cameras that have the lens of one of them: its group, or itself.
pub(crate) fn sharers(groups: &[Group], camera: CameraId) -> Group {
    groups.iter().find(|group| group.contains(&camera)).cloned().unwrap_or_else(|| vec![camera])
}

/// Gives the lens that is told of one camera to all that share it, and refuses two that the job states to differ.
pub(crate) fn spread_stated(
    dataset: &Dataset,
    groups: &[Group],
    stated: &mut Vec<(CameraId, Camera)>,
) -> Result<(), Error> {
    for group in groups {
        let mut told = stated.iter().filter(|(camera, _)| group.contains(camera));
        if let Some((first, lens)) = told.next()
            && let Some((other, _)) = told.find(|(_, other)| other != lens)
        {
            return Err(apart(dataset, [*first, *other], "the job states two that differ".to_owned()));
        }
    }
    spread(groups, stated);
    Ok(())
}

/// Gives the lens that is told first of a group to those of it of which none is told.
pub(crate) fn spread(groups: &[Group], told: &mut Vec<(CameraId, Camera)>) {
    for group in groups {
        let Some((_, lens)) = told.iter().find(|(camera, _)| group.contains(camera)).cloned() else {
            continue;
        };
        for camera in group {
            if !told.iter().any(|(known, _)| known == camera) {
                told.push((*camera, lens.clone()));
            }
        }
    }
}

/// Returns the camera of this name.
pub(crate) fn camera_of(dataset: &Dataset, name: &str) -> Result<CameraId, Error> {
    let found = dataset.cameras.enumerate().find(|(_, camera)| camera.name == name);
    found.map(|(id, _)| id).ok_or_else(|| Error::UnknownCamera {
        name: name.to_owned(),
        known: dataset.cameras.iter().map(|camera| camera.name.clone()).collect(),
    })
}

/// Returns the error that says why two cameras cannot share a lens.
pub(crate) fn apart(dataset: &Dataset, cameras: [CameraId; 2], why: String) -> Error {
    Error::LensesApart { cameras: cameras.map(|camera| dataset.cameras[camera].name.clone()), why }
}

#[cfg(test)]
mod tests {
    use boresight_data::CameraInfo;

    use super::*;

    #[test]
    fn groups_with_a_common_camera_are_one() {
        let camera = |name: &str| CameraInfo {
            name: name.to_owned(),
            image_size: if name == "e" { [8, 6] } else { [640, 480] },
        };
        let dataset = Dataset {
            cameras: ["a", "b", "c", "d", "e"].map(camera).into_iter().collect(),
            ..Dataset::default()
        };
        let found = |texts: &[&str]| {
            let texts: Vec<String> = texts.iter().map(|text| (*text).to_owned()).collect();
            let ids = |group: Group| group.into_iter().map(|camera| camera.0).collect::<Vec<u32>>();
            groups(&dataset, &texts).map(|groups| groups.into_iter().map(ids).collect::<Vec<_>>())
        };
        assert_eq!(found(&["b+a", "d+c"]).unwrap(), [vec![0, 1], vec![2, 3]]);
        assert_eq!(found(&["a+b", "c+d", "d+b"]).unwrap(), [vec![0, 1, 2, 3]]);
        let error = found(&["a+e"]).unwrap_err().to_string();
        assert!(
            error.contains("cameras a and e cannot share a lens: the images are 640x480 and 8x6"),
            "{error}"
        );
        assert!(found(&["a+x"]).unwrap_err().to_string().contains("no camera `x`"));
    }
}
