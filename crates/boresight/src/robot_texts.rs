//! The long text of each finding of the robot commands.

/// The codes in alphabetical order, with what they mean.
pub(crate) const TEXTS: &[(&str, &str)] = &[
    (
        "ambiguous-pose",
        "What it means: more than one pose of the object explains the points that were seen. Three points have two poses\n\
         in most views and up to four in others; a flat or distant object may keep two with more points.\n\n\
         Why it matters: which pose is listed first is decided by how well it is known, or by little misfit, not by the scene;\n\
         a robot that trusts it may reach to the wrong side.\n\n\
         How to fix it: see a fourth point off the plane of the others, or choose the pose that the scene allows. The list\n\
         has all of them with their covariance.",
    ),
    (
        "camera-below-plane",
        "What it means: the touches, and the pixels they are seen at, say that the camera looks at the plane from the side to\n\
         which the robot's z axis does not point: from below, for most robots.\n\n\
         Why it matters: a camera under a window does so. Where none is, the touches are mirrored.\n\n\
         How to fix it: check that u and v, and x and y, are not exchanged, and that y has its sign.",
    ),
    (
        "few-touches",
        "What it means: the touches hardly outnumber the unknowns of the fit.\n\n\
         Why it matters: a bad touch cannot be told from a good one, and the stated sigmas rest on few residuals.\n\n\
         How to fix it: touch nine points in three rows over the whole area where parts will lie.",
    ),
    (
        "height-ignored",
        "What it means: an object's points lie above the robot's plane, and the plane was calibrated without a lens.\n\n\
         Why it matters: the camera sees them shifted sideways by the height times the tangent of the angle of view; this shift\n\
         cannot be computed without the camera's place.\n\n\
         How to fix it: calibrate the lens, and give the calibration to `boresight robot plane`.",
    ),
    (
        "height-matters",
        "What it means: the correction for the height of an object's points is large against the sigma of its position.\n\n\
         Why it matters: an error of the height enters the position by the share that the finding names.\n\n\
         How to fix it: state the sigma of the height with `height_sigma_mm`, or measure the height better.",
    ),
    (
        "height-of-touch",
        "What it means: a point was touched well above or below the plane of all touches.\n\n\
         Why it matters: the tip was pressed into the sheet, is worn, or the surface is not flat there; positions near it are off\n\
         by the height times the tangent of the angle of view.\n\n\
         How to fix it: touch the point again, or take a flat surface.",
    ),
    (
        "height-unknown",
        "What it means: no height of the object's points above the calibrated plane was stated.\n\n\
         Why it matters: parts are taller than the sheet that was calibrated; each millimetre moves them sideways as the\n\
         finding says.\n\n\
         How to fix it: state `height_mm`, zero for points in the plane.",
    ),
    (
        "image-not-parallel",
        "What it means: the image plane is not parallel to the robot's plane, or the lens distorts, by more than the touches err.\n\n\
         Why it matters: the textbook's procedure, and the nine-point tables of many controllers, take one factor from pixels to\n\
         millimetres; their error is the first figure of the finding.\n\n\
         How to fix it: nothing, as long as the plane that was written is used. Its model was chosen by how well it predicts\n\
         touches that it was not fitted to.",
    ),
    (
        "lambda-mismatch",
        "What it means: distances between touched points are not those of the pattern.\n\n\
         Why it matters: the ratio of millimetres to pixels then depends on whom one believes, and so does every position.\n\n\
         How to fix it: check that robot and pattern are in one unit, that the fields have the stated size, and that the\n\
         touched points are those that are listed.",
    ),
    (
        "large-misfit",
        "What it means: the points miss their pixels by far more than the stated sigma.\n\n\
         Why it matters: the calibration, the points of the object or the sigma is wrong; the stated covariance is too small.\n\n\
         How to fix it: check that the calibration is that of this camera at this resolution and focus, and that the object's\n\
         points are in the stated unit.",
    ),
    (
        "merging-poses",
        "What it means: two poses of the three points are all but one.\n\n\
         Why it matters: small errors of the pixels move such a pose far, most of all its tilt.\n\n\
         How to fix it: look at the points from further aside, or see a fourth point.",
    ),
    (
        "no-heights",
        "What it means: the touches have no column z.\n\n\
         Why it matters: the plane is taken for z = 0, and the heights of parts are counted from there.\n\n\
         How to fix it: add a column z_mm to the table if heights matter.",
    ),
    (
        "object-beside-touches",
        "What it means: an object lies far from where the plane was touched.\n\n\
         Why it matters: the map is extrapolated there. Its stated sigma grows with the distance, but a table that is not flat,\n\
         or a lens that was not calibrated so far out, is not in it.\n\n\
         How to fix it: touch points around the place where parts lie.",
    ),
    (
        "object-misfit",
        "What it means: the seen points of an object do not fit its drawing within their sigma.\n\n\
         Why it matters: one of the points, their height or their unit is wrong, and the pose with it.\n\n\
         How to fix it: check the points, their order and their height above the plane.",
    ),
    (
        "object-outside-image",
        "What it means: an object is said to be seen at a pixel that the image does not have.\n\n\
         Why it matters: the columns are exchanged, or the image had another size than the one that was calibrated.\n\n\
         How to fix it: check u_px and v_px, and use images of the calibrated size.",
    ),
    (
        "outlying-point",
        "What it means: a point is seen far from where the pose puts it; the pose does not rest on it.\n\n\
         Why it matters: it was paired with the wrong pixel, or the object is not as drawn.\n\n\
         How to fix it: check the point's coordinates and its pixel.",
    ),
    (
        "outlying-touch",
        "What it means: a touch is far from where the fit to all other touches predicts it.\n\n\
         Why it matters: one bad touch moves the plane; the usual cause is a point paired with the wrong pixel, or a tip that\n\
         slipped.\n\n\
         How to fix it: touch the point again.",
    ),
    (
        "planar-many-left-out",
        "What it means: more than a tenth of the intervals of a robot on wheels do not fit the others within four sigmas.\n\n\
         Why it matters: some bad scan matches are usual; many of them, or one kind of motion left out as a whole, mean that the\n\
         rest is not what it seems.\n\n\
         How to fix it: look for slipping wheels, bad matches of the sensor's scans, and clocks that are apart.",
    ),
    (
        "planar-uncertain",
        "What it means: a wheel's radius or the axle is known to a few percent only.\n\n\
         Why it matters: every way and turn that is computed from the wheels is off by as much.\n\n\
         How to fix it: record more intervals; turns on the spot tell the axle, straight ways the wheels, curves the sensor's place.",
    ),
    (
        "planar-unit",
        "What it means: a wheel's radius came out as no wheel's, or negative.\n\n\
         Why it matters: a unit or a sign of the motions is wrong, and every number of the result with it.\n\n\
         How to fix it: give durations in seconds, speeds of wheels in radians a second, positive forward, and the sensor's\n\
         motion in metres and radians; check that left and right are not exchanged.",
    ),
    (
        "thin-triangle",
        "What it means: the three points are nearly on a line.\n\n\
         Why it matters: the turn about that line is then hardly known.\n\n\
         How to fix it: choose points that span a wider triangle.",
    ),
    (
        "tip-partly-open",
        "What it means: the flange turned about one axis only while the touches were taken.\n\n\
         Why it matters: the length of the tip along that axis is not known, and with it the height of the plane; positions in\n\
         the plane are not affected.\n\n\
         How to fix it: tilt the flange by 30 degrees or more in some touches.",
    ),
    (
        "touch-outside-image",
        "What it means: touches are said to be seen at pixels that the image does not have.\n\n\
         Why it matters: pixels and positions are exchanged, or the calibration is of another camera or resolution; the plane\n\
         is then one of nothing.\n\n\
         How to fix it: check the columns u_px, v_px, x_mm, y_mm, and which calibration was given.",
    ),
    (
        "touch-unit",
        "What it means: the touches span less than 5 mm or more than 20 m.\n\n\
         Why it matters: no robot's table is so small or so large; the numbers are in another unit than their columns say, and\n\
         every position that comes of them is wrong by a factor of a thousand.\n\n\
         How to fix it: name the columns by the unit of their numbers: x_mm,y_mm,z_mm or x_m,y_m,z_m.",
    ),
    (
        "touches-better-than-stated",
        "What it means: touches and pixels meet the plane ten times better than their stated sigmas say, or more.\n\n\
         Why it matters: noise does not do that. Touches in metres under a name for millimetres do, and computed ones.\n\n\
         How to fix it: check the units of touches and of the sigmas.",
    ),
    (
        "touches-coarse",
        "What it means: no sigma of a touch was stated, and the residuals say that it is above a millimetre.\n\n\
         Why it matters: robots touch to some tenths of a millimetre. Exchanged columns, wrong pairs of pixels and positions, or\n\
         a lens that distorts and is not calibrated look like this. The covariance is as wide as the residuals.\n\n\
         How to fix it: check the table; give the calibration of the lens.",
    ),
    (
        "touches-worse-than-stated",
        "What it means: touches and pixels miss the plane by more than their stated sigmas explain.\n\n\
         Why it matters: the stated sigmas are those of repeating a touch, not of the robot's accuracy, or the lens distorts and\n\
         no calibration of it was given. The covariance that was written is widened accordingly.\n\n\
         How to fix it: state the robot's absolute accuracy, usually 0.3 to 1 mm, mend outlying touches, or give a calibrated lens.",
    ),
];
