// Solves a board-calibration problem with Ceres, as a fair peer for Boresight.
//
//   ba PROBLEM.bin [--repeat N] [--solution OUT.bin]
//
// One analytic cost functor per board observation, DENSE_SCHUR with the frame poses eliminated
// first, one thread. The objective is mrcal 2.2's: plain sum of squares, OPENCV8 lenses, a board
// bent by two coefficients, and that release's regularisation rows. Cameras whose extrinsics index
// is -1 are at the reference, so they have no pose to estimate.
//
// PROBLEM.bin is little-endian and has no padding:
//
//   char[8]  "BSBA0001"
//   u32      cameras, extrinsics, frames, views, board width (inner corners in x), board height
//   f64      spacing between corners, in metres
//   i32      image size [cameras][2]: width, height
//   i32      index      [views][3]:   frame, camera, extrinsics (-1 = at the reference)
//   f64      intrinsics [cameras][12]: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6   (seed)
//   f64      extrinsics [extrinsics][6]: cam_from_ref, Rodrigues vector, translation (seed)
//   f64      frames     [frames][6]:     ref_from_board, likewise (seed)
//   f64      warp       [2]: deflection of the board centre along its z, from x and from y (seed)
//   f64      observation [views][height][width][3]: u px, v px, weight (negative = rejected)
//
// OUT.bin is the same file with the seed replaced by the solution.
//
// The answer is one line of JSON on stdout. `cost` is the plain sum of squares with the
// regularisation in it, twice what Ceres calls cost.
//
// Public Ceres headers hand no Eigen object by value between this program and the library, so
// compiling this file alone for the native instruction set does not break Eigen's alignment.

#include <ceres/ceres.h>
#include <ceres/version.h>

#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

constexpr int kIntrinsics = 12;
constexpr int kPose = 6;
constexpr int kWarp = 2;

struct Problem {
  uint32_t n_cameras, n_extrinsics, n_frames, n_views, width, height;
  double spacing;
  std::vector<int32_t> image_size;
  std::vector<int32_t> index;
  std::vector<double> intrinsics, extrinsics, frames, warp, observations;
};

template <class T>
void ReadInto(std::ifstream& in, T* out, size_t count) {
  in.read(reinterpret_cast<char*>(out), static_cast<std::streamsize>(count * sizeof(T)));
  if (!in) throw std::runtime_error("the problem file ends too early");
}

template <class T>
void ReadInto(std::ifstream& in, std::vector<T>& out, size_t count) {
  out.resize(count);
  ReadInto(in, out.data(), count);
}

Problem Load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) throw std::runtime_error("cannot open " + path);
  char magic[8];
  ReadInto(in, magic, 8);
  if (std::memcmp(magic, "BSBA0001", 8) != 0)
    throw std::runtime_error(path + " is not a BSBA0001 problem; make one with make_problem.py convert");
  Problem p;
  uint32_t n[6];
  ReadInto(in, n, 6);
  p.n_cameras = n[0], p.n_extrinsics = n[1], p.n_frames = n[2], p.n_views = n[3];
  p.width = n[4], p.height = n[5];
  ReadInto(in, &p.spacing, 1);
  ReadInto(in, p.image_size, size_t{2} * p.n_cameras);
  ReadInto(in, p.index, size_t{3} * p.n_views);
  ReadInto(in, p.intrinsics, size_t{kIntrinsics} * p.n_cameras);
  ReadInto(in, p.extrinsics, size_t{kPose} * p.n_extrinsics);
  ReadInto(in, p.frames, size_t{kPose} * p.n_frames);
  ReadInto(in, p.warp, kWarp);
  ReadInto(in, p.observations, size_t{3} * p.n_views * p.width * p.height);
  for (uint32_t view = 0; view < p.n_views; ++view) {
    const int32_t* i = &p.index[3 * view];
    if (i[0] < 0 || i[0] >= int64_t{p.n_frames} || i[1] < 0 || i[1] >= int64_t{p.n_cameras} || i[2] < -1 ||
        i[2] >= int64_t{p.n_extrinsics})
      throw std::runtime_error("view " + std::to_string(view) + " has an index out of range");
  }
  return p;
}

template <class T>
void Write(std::ofstream& out, const T* data, size_t count) {
  out.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(count * sizeof(T)));
}

void Save(const Problem& p, const std::string& path) {
  std::ofstream out(path, std::ios::binary);
  const uint32_t n[6] = {p.n_cameras, p.n_extrinsics, p.n_frames, p.n_views, p.width, p.height};
  Write(out, "BSBA0001", 8);
  Write(out, n, 6);
  Write(out, &p.spacing, 1);
  Write(out, p.image_size.data(), p.image_size.size());
  Write(out, p.index.data(), p.index.size());
  Write(out, p.intrinsics.data(), p.intrinsics.size());
  Write(out, p.extrinsics.data(), p.extrinsics.size());
  Write(out, p.frames.data(), p.frames.size());
  Write(out, p.warp.data(), p.warp.size());
  Write(out, p.observations.data(), p.observations.size());
  if (!out) throw std::runtime_error("cannot write " + path);
}

// The rotation of a Rodrigues vector, and the matrix that turns a small change of that vector
// into a small rotation applied on the left (the left Jacobian of SO(3)).
struct Rotation {
  double r[9];
  double left[9];

  explicit Rotation(const double* v) {
    const double theta2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    double a, b, c;  // sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3
    if (theta2 < 1e-8) {
      a = 1.0 - theta2 / 6.0;
      b = 0.5 - theta2 / 24.0;
      c = 1.0 / 6.0 - theta2 / 120.0;
    } else {
      const double theta = std::sqrt(theta2);
      a = std::sin(theta) / theta;
      b = (1.0 - std::cos(theta)) / theta2;
      c = (1.0 - a) / theta2;
    }
    const double cross[9] = {0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        // The square of the cross-product matrix is v v' - theta^2 I.
        const double square = v[i] * v[j] - (i == j ? theta2 : 0.0);
        const double one = i == j ? 1.0 : 0.0;
        r[3 * i + j] = one + a * cross[3 * i + j] + b * square;
        left[3 * i + j] = one + b * cross[3 * i + j] + c * square;
      }
    }
  }
};

inline void Multiply(const double* m, const double* x, double* y) {
  for (int i = 0; i < 3; ++i) y[i] = m[3 * i] * x[0] + m[3 * i + 1] * x[1] + m[3 * i + 2] * x[2];
}

inline void MultiplyTransposed(const double* m, const double* x, double* y) {
  for (int i = 0; i < 3; ++i) y[i] = m[i] * x[0] + m[3 + i] * x[1] + m[6 + i] * x[2];
}

inline void Cross(const double* a, const double* b, double* out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// The geometry of the board: one copy, shared by all functors.
struct Board {
  std::vector<double> x, y, bend_x, bend_y;

  Board(int width, int height, double spacing) {
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        const double xr = column / double(width - 1), yr = row / double(height - 1);
        x.push_back(column * spacing);
        y.push_back(row * spacing);
        bend_x.push_back(4 * xr * (1 - xr));
        bend_y.push_back(4 * yr * (1 - yr));
      }
    }
  }
  int size() const { return static_cast<int>(x.size()); }
};

// All corners of one board seen by one camera. Parameter blocks: intrinsics, [camera pose,] frame
// pose, warp.
class BoardObservation final : public ceres::CostFunction {
 public:
  BoardObservation(const Board& board, const double* observations, bool at_reference)
      : board_(board), observations_(observations), at_reference_(at_reference) {
    set_num_residuals(2 * board.size());
    mutable_parameter_block_sizes()->push_back(kIntrinsics);
    if (!at_reference) mutable_parameter_block_sizes()->push_back(kPose);
    mutable_parameter_block_sizes()->push_back(kPose);
    mutable_parameter_block_sizes()->push_back(kWarp);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    constexpr double zero_pose[kPose] = {0, 0, 0, 0, 0, 0};
    const int frame_block = at_reference_ ? 1 : 2;
    const double* k = parameters[0] + 4;
    const double fx = parameters[0][0], fy = parameters[0][1];
    const double cx = parameters[0][2], cy = parameters[0][3];
    const double* camera = at_reference_ ? zero_pose : parameters[1];
    const double* frame = parameters[frame_block];
    const double* warp = parameters[frame_block + 1];
    const Rotation camera_rotation(camera), frame_rotation(frame);
    const double* rc = camera_rotation.r;
    const double* rf = frame_rotation.r;

    double* j_intrinsics = jacobians ? jacobians[0] : nullptr;
    double* j_camera = jacobians && !at_reference_ ? jacobians[1] : nullptr;
    double* j_frame = jacobians ? jacobians[frame_block] : nullptr;
    double* j_warp = jacobians ? jacobians[frame_block + 1] : nullptr;

    // The board's own z axis as the camera sees it: the direction in which the warp moves a corner.
    const double z_in_ref[3] = {rf[2], rf[5], rf[8]};
    double z_in_cam[3];
    Multiply(rc, z_in_ref, z_in_cam);

    for (int i = 0; i < board_.size(); ++i) {
      const double weight = observations_[3 * i + 2];
      if (weight < 0) {
        residuals[2 * i] = residuals[2 * i + 1] = 0;
        if (j_intrinsics) std::fill_n(j_intrinsics + 2 * kIntrinsics * i, 2 * kIntrinsics, 0.0);
        if (j_camera) std::fill_n(j_camera + 2 * kPose * i, 2 * kPose, 0.0);
        if (j_frame) std::fill_n(j_frame + 2 * kPose * i, 2 * kPose, 0.0);
        if (j_warp) std::fill_n(j_warp + 2 * kWarp * i, 2 * kWarp, 0.0);
        continue;
      }

      const double point[3] = {board_.x[i], board_.y[i], warp[0] * board_.bend_x[i] + warp[1] * board_.bend_y[i]};
      double turned_by_frame[3], turned_by_camera[3];
      Multiply(rf, point, turned_by_frame);
      const double in_ref[3] = {turned_by_frame[0] + frame[3], turned_by_frame[1] + frame[4],
                                turned_by_frame[2] + frame[5]};
      Multiply(rc, in_ref, turned_by_camera);
      const double pz = turned_by_camera[2] + camera[5];
      if (!(pz > 0)) return false;
      const double iz = 1.0 / pz;
      const double x = (turned_by_camera[0] + camera[3]) * iz, y = (turned_by_camera[1] + camera[4]) * iz;

      const double xx = x * x, yy = y * y, xy = x * y;
      const double r2 = xx + yy, r4 = r2 * r2, r6 = r4 * r2;
      const double numerator = 1 + k[0] * r2 + k[1] * r4 + k[4] * r6;
      const double inverse = 1.0 / (1 + k[5] * r2 + k[6] * r4 + k[7] * r6);
      const double s = numerator * inverse;
      const double xd = x * s + 2 * k[2] * xy + k[3] * (r2 + 2 * xx);
      const double yd = y * s + k[2] * (r2 + 2 * yy) + 2 * k[3] * xy;
      residuals[2 * i] = weight * (fx * xd + cx - observations_[3 * i]);
      residuals[2 * i + 1] = weight * (fy * yd + cy - observations_[3 * i + 1]);
      if (!jacobians) continue;

      const double wfx = weight * fx, wfy = weight * fy;
      if (j_intrinsics) {
        double* row_u = j_intrinsics + 2 * kIntrinsics * i;
        double* row_v = row_u + kIntrinsics;
        // How the radial factor answers to each of its six coefficients.
        const double ds[6] = {r2 * inverse, r4 * inverse, r6 * inverse,
                              -s * r2 * inverse, -s * r4 * inverse, -s * r6 * inverse};
        constexpr int column_of[6] = {4, 5, 8, 9, 10, 11};
        row_u[0] = weight * xd, row_u[1] = 0, row_u[2] = weight, row_u[3] = 0;
        row_v[0] = 0, row_v[1] = weight * yd, row_v[2] = 0, row_v[3] = weight;
        for (int j = 0; j < 6; ++j) {
          row_u[column_of[j]] = wfx * x * ds[j];
          row_v[column_of[j]] = wfy * y * ds[j];
        }
        row_u[6] = wfx * 2 * xy, row_u[7] = wfx * (r2 + 2 * xx);
        row_v[6] = wfy * (r2 + 2 * yy), row_v[7] = wfy * 2 * xy;
      }

      // Twice the slope of the radial factor over r^2, so that its gradient is (x, y) times this.
      const double slope = 2 * inverse *
                           (k[0] + 2 * k[1] * r2 + 3 * k[4] * r4 - s * (k[5] + 2 * k[6] * r2 + 3 * k[7] * r4));
      const double dxd_dx = s + xx * slope + 2 * k[2] * y + 6 * k[3] * x;
      const double dxd_dy = xy * slope + 2 * k[2] * x + 2 * k[3] * y;
      const double dyd_dy = s + yy * slope + 6 * k[2] * y + 2 * k[3] * x;
      const double dyd_dx = dxd_dy;
      const double gradient[2][3] = {
          {wfx * iz * dxd_dx, wfx * iz * dxd_dy, -wfx * iz * (x * dxd_dx + y * dxd_dy)},
          {wfy * iz * dyd_dx, wfy * iz * dyd_dy, -wfy * iz * (x * dyd_dx + y * dyd_dy)}};

      for (int row = 0; row < 2; ++row) {
        const double* g = gradient[row];
        double moment[3];
        if (j_camera) {
          double* out = j_camera + kPose * (2 * i + row);
          Cross(turned_by_camera, g, moment);
          MultiplyTransposed(camera_rotation.left, moment, out);
          std::copy_n(g, 3, out + 3);
        }
        if (j_frame) {
          double* out = j_frame + kPose * (2 * i + row);
          double in_ref_gradient[3];
          MultiplyTransposed(rc, g, in_ref_gradient);
          Cross(turned_by_frame, in_ref_gradient, moment);
          MultiplyTransposed(frame_rotation.left, moment, out);
          std::copy_n(in_ref_gradient, 3, out + 3);
        }
        if (j_warp) {
          double* out = j_warp + kWarp * (2 * i + row);
          const double along = g[0] * z_in_cam[0] + g[1] * z_in_cam[1] + g[2] * z_in_cam[2];
          out[0] = along * board_.bend_x[i];
          out[1] = along * board_.bend_y[i];
        }
      }
    }
    return true;
  }

 private:
  const Board& board_;
  const double* observations_;
  bool at_reference_;
};

// mrcal 2.2's pull of one camera's distortion towards zero and of its centre towards the middle of
// the image. The scales grow with the amount of data.
class Regularization final : public ceres::SizedCostFunction<10, kIntrinsics> {
 public:
  Regularization(const Problem& p, int camera) {
    const double n_measurements = 2.0 * p.n_views * p.width * p.height;
    const double n_cameras = p.n_cameras;
    const double distortion = std::sqrt(n_measurements * 0.005 / 2 / (n_cameras * 8 * 2.0 * 2.0));
    const double centre = std::sqrt(n_measurements * 0.005 / 2 / (n_cameras * 2 * 500.0 * 500.0));
    for (int j = 0; j < 8; ++j) scale_[j] = distortion * (j >= 5 ? 5.0 : 1.0);
    for (int j = 0; j < 2; ++j) {
      scale_[8 + j] = centre;
      middle_[j] = (p.image_size[2 * camera + j] - 1) / 2.0;
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const double* intrinsics = parameters[0];
    for (int j = 0; j < 8; ++j) residuals[j] = scale_[j] * intrinsics[4 + j];
    for (int j = 0; j < 2; ++j) residuals[8 + j] = scale_[8 + j] * (intrinsics[2 + j] - middle_[j]);
    if (jacobians && jacobians[0]) {
      std::fill_n(jacobians[0], 10 * kIntrinsics, 0.0);
      for (int j = 0; j < 8; ++j) jacobians[0][kIntrinsics * j + 4 + j] = scale_[j];
      for (int j = 0; j < 2; ++j) jacobians[0][kIntrinsics * (8 + j) + 2 + j] = scale_[8 + j];
    }
    return true;
  }

 private:
  double scale_[10];
  double middle_[2];
};

double CpuSeconds() {
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

// Builds the Ceres problem on `p`'s arrays, solves it in place and returns the CPU seconds of Solve.
double SolveOnce(Problem& p, ceres::Solver::Summary* summary) {
  const Board board(p.width, p.height, p.spacing);
  ceres::Problem problem;
  ceres::Solver::Options options;
  auto* ordering = new ceres::ParameterBlockOrdering;
  options.linear_solver_ordering.reset(ordering);

  for (uint32_t view = 0; view < p.n_views; ++view) {
    const int frame = p.index[3 * view], camera = p.index[3 * view + 1], extrinsics = p.index[3 * view + 2];
    const double* observations = &p.observations[size_t{3} * p.width * p.height * view];
    std::vector<double*> blocks = {&p.intrinsics[kIntrinsics * camera]};
    if (extrinsics >= 0) blocks.push_back(&p.extrinsics[kPose * extrinsics]);
    blocks.push_back(&p.frames[kPose * frame]);
    blocks.push_back(p.warp.data());
    problem.AddResidualBlock(new BoardObservation(board, observations, extrinsics < 0), nullptr, blocks);
    ordering->AddElementToGroup(&p.frames[kPose * frame], 0);
    for (double* block : blocks)
      if (block != &p.frames[kPose * frame]) ordering->AddElementToGroup(block, 1);
  }
  for (uint32_t camera = 0; camera < p.n_cameras; ++camera)
    if (problem.HasParameterBlock(&p.intrinsics[kIntrinsics * camera]))
      problem.AddResidualBlock(new Regularization(p, camera), nullptr, &p.intrinsics[kIntrinsics * camera]);

  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.num_threads = 1;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-12;
  // The change of the cost alone decides when to stop.
  options.gradient_tolerance = 1e-30;
  options.parameter_tolerance = 1e-30;
  options.logging_type = ceres::SILENT;

  const double start = CpuSeconds();
  ceres::Solve(options, &problem, summary);
  return CpuSeconds() - start;
}

}  // namespace

int main(int argc, char** argv) try {
  std::string path, solution;
  int repeat = 1;
  for (int i = 1; i < argc; ++i) {
    const std::string arg = argv[i];
    if (arg == "--repeat" && i + 1 < argc) {
      repeat = std::max(1, std::atoi(argv[++i]));
    } else if (arg == "--solution" && i + 1 < argc) {
      solution = argv[++i];
    } else if (path.empty() && arg[0] != '-') {
      path = arg;
    } else {
      path.clear();
      break;
    }
  }
  if (path.empty()) {
    std::fprintf(stderr, "usage: ba PROBLEM.bin [--repeat N] [--solution OUT.bin]\n");
    return 2;
  }

  Problem problem = Load(path);
  const auto intrinsics = problem.intrinsics, extrinsics = problem.extrinsics;
  const auto frames = problem.frames, warp = problem.warp;
  std::vector<double> seconds;
  ceres::Solver::Summary summary;
  for (int i = 0; i < repeat; ++i) {
    problem.intrinsics = intrinsics, problem.extrinsics = extrinsics;
    problem.frames = frames, problem.warp = warp;
    seconds.push_back(SolveOnce(problem, &summary));
  }
  if (!solution.empty()) Save(problem, solution);

  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  std::vector<double> sorted = seconds;
  std::sort(sorted.begin(), sorted.end());
  std::printf("{\"tool\": \"ceres\", \"version\": \"%s\", \"cpu_s\": %.6f, \"cpu_s_each\": [", CERES_VERSION_STRING,
              sorted[sorted.size() / 2]);
  for (size_t i = 0; i < seconds.size(); ++i) std::printf("%s%.6f", i ? ", " : "", seconds[i]);
  std::printf("], \"iterations\": %d, \"evaluations\": %d, \"cost\": %.12f, \"converged\": %s, \"peak_rss_kb\": %ld, "
              "\"problem\": \"same\"}\n",
              int(summary.iterations.size()) - 1, summary.num_residual_evaluations, 2 * summary.final_cost,
              summary.termination_type == ceres::CONVERGENCE ? "true" : "false", usage.ru_maxrss);
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "ba: %s\n", error.what());
  return 3;
}
