//! Golden tests: the answers of mrcal 2.2 and OpenCV 5.0.0 on the same observations.
//!
//! They need the conformance data beside the project, and say so where it is not present.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic, and says what it measured")]

mod golden {
    mod exact_uncertainty;
    mod hand_eye;
    mod monte_carlo;
    mod mrcal_problems;
    mod objective;
    mod opencv_corners;
    mod outliers;
    mod poses;
    mod robot_noise_bound;
    mod several_boards;
    mod sigma_reference;
    mod synthetic_rigs;
    mod triangulation;
    mod uncertainty;
    mod uncertainty_scatter;
    mod wide_fisheye;
}
