//! The long texts of findings about recordings.

/// Each code with its text.
pub(crate) const RECORDING_TEXTS: &[(&str, &str)] = &[
    (
        "camera-recorded-twice",
        "What it means: two topics hold the images of one camera, such as raw and compressed ones. The raw ones are used.\n\n\
         Why it matters: the same image twice adds no information, but would count as if it did.\n\n\
         How to fix it: nothing needs to be done. If they are of two cameras, name both: --camera NAME=TOPIC for each.",
    ),
    (
        "cameras-apart-in-time",
        "What it means: most images of one camera have no image of the other within the tolerance. Where the distance is\n\
         always the same, it is told with how much it varies.\n\n\
         Why it matters: images of one frame are taken as of one instant. Where the target moves, cameras that look at\n\
         different instants disagree about where it is, and the rig between them comes out wrong, or stays unconnected\n\
         as they share no frames.\n\n\
         How to fix it: trigger the cameras together. If they are triggered together and only their time stamps differ, or\n\
         if the target stood still, widen the tolerance with --sync-tolerance, or sync_tolerance_ms in [input] of the job.\n\
         Where the stamps are worthless, --clock log takes the times of recording.",
    ),
    (
        "no-time-stamps",
        "What it means: the time stamp in the header of each message is zero. The times at which the messages were recorded\n\
         are taken instead.\n\n\
         Why it matters: between the exposure and the recording lie transfer and queues, which differ from image to image.\n\n\
         How to fix it: let the camera's driver set header.stamp to the time of exposure.",
    ),
    (
        "recording-cut-off",
        "What it means: the file ends before its end: the recorder was stopped hard, the disk was full, or the file was copied\n\
         while it was written. What is there is used.\n\n\
         Why it matters: what came later is lost.\n\n\
         How to fix it: copy the file again from its source, and let the recorder end by itself.",
    ),
    (
        "recording-damaged",
        "What it means: a part of the file is not as it was written. What can be read is used: a chunk up to where it is\n\
         damaged, and the chunks after it.\n\n\
         Why it matters: the images in that part are lost, and where only a checksum tells, some may be spoilt.\n\n\
         How to fix it: copy the file again from its source.",
    ),
    (
        "repeated-time-stamps",
        "What it means: a camera has several images with the same time stamp. The first of each is used.\n\n\
         Why it matters: a camera sees one image at a time; which of them belongs to that instant cannot be told.\n\n\
         How to fix it: set the time stamp of each image when it is taken, or take the times of recording with --clock log.",
    ),
    (
        "topic-not-read",
        "What it means: a topic holds images or video in a form that is not read.\n\n\
         Why it matters: its camera is absent from the calibration.\n\n\
         How to fix it: record raw, JPEG or PNG images as ROS 2, ROS 1 or Foxglove messages, or convert the recording. Video\n\
         in H.264 is read by a program that was built with the feature h264; it is compressed with losses that move corners,\n\
         so images are better where accuracy counts.",
    ),
    (
        "topic-without-camera",
        "What it means: a topic holds images, and the job lists cameras of which none is its own. It is left out.\n\n\
         Why it matters: if it is a camera of the rig, its information is lost.\n\n\
         How to fix it: add a [[camera]] with its name, or with its topic as `images`, which may have * and ?.",
    ),
    (
        "unreadable-messages",
        "What it means: some messages of a topic are not what their schema says, or hold an image that cannot be decoded. They\n\
         are left out, and the commonest reason is told.\n\n\
         Why it matters: if they show the target, their information is lost.\n\n\
         How to fix it: plain CDR is read, as ROS 2 writes it unless it is told otherwise; XCDR2 is not. Pixels are read as\n\
         grey, RGB, BGR, with or without alpha, YUV 4:2:2, NV12 and behind a Bayer filter, in 8 and, but for YUV, 16 bits; images as\n\
         JPEG, PNG, TIFF and PNM. A frame of a video needs the keyframe before it and all frames since. For anything else,\n\
         convert the recording.",
    ),
];
