#include "supervisor/strike/inverse_kinematics.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/core/random.h"
#include "supervisor/strike/joint_norm.h"

namespace mrr::sup {
namespace {

constexpr double kPositionTolerance = 1e-7;  // m
constexpr double kMetresPerRadian = 0.3;     // what a radian of tilt counts against a metre
constexpr double kLimitMargin = 0.02;        // rad: a struck pose keeps away from its stops by this
constexpr int kIterations = 120;
constexpr double kOffCentreSearch = 5.0;
constexpr int kLeastStarts = 24;

using Residual = Eigen::Matrix<double, 6, 1>;

/// Rotation vector that turns unit a onto unit b the short way; its length is the angle, rad.
Eigen::Vector3d rotation_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d cross = a.cross(b);
  const double s = cross.norm();
  const double c = a.dot(b);
  if (s > 1e-12) return cross * (std::atan2(s, c) / s);
  if (c > 0.0) return Eigen::Vector3d::Zero();
  return a.unitOrthogonal() * std::numbers::pi;
}

struct Problem {
  const Chain& chain;
  const FaceTarget& target;
  JointVector lower;
  JointVector upper;

  [[nodiscard]] FaceSolution assess(const JointVector& q) const {
    const Pose face = chain.face_pose(q);
    const Eigen::Vector3d off = face.position_m - target.position_m;
    FaceSolution s;
    s.q = q;
    s.normal_error_m = off.dot(target.normal);
    s.lateral_error_m = (off - target.normal * s.normal_error_m).norm();
    s.tilt_rad = rotation_between(face.rotation.col(2), -target.normal).norm();
    return s;
  }

  [[nodiscard]] JointVector clamped(const JointVector& q) const { return q.cwiseMax(lower).cwiseMin(upper); }
};

/// What a search counts as error: metres along the normal, metres sideways, radians of tilt beyond `free_tilt_rad`.
struct Weights {
  double normal = 1.0;
  double lateral = 1.0;
  double tilt = 1.0;
  double free_tilt_rad = 0.0;
};

struct Linearised {
  Residual error;
  Jacobian J;
  int rows = 6;  ///< 3: tilt does not count
};

void linearise(const Problem& problem, const JointVector& q, const Weights& w, Linearised& l) {
  const ChainPose pose = problem.chain.pose(q);
  const Eigen::Vector3d n = problem.target.normal;
  const Eigen::Vector3d off = problem.target.position_m - pose.face.position_m;
  l.J = problem.chain.jacobian(pose);
  l.error.head<3>() = w.lateral * off + (w.normal - w.lateral) * n.dot(off) * n;
  for (Eigen::Index i = 0; i < l.J.cols(); ++i) {
    const Eigen::Vector3d v = l.J.col(i).head<3>();
    l.J.col(i).head<3>() = w.lateral * v + (w.normal - w.lateral) * n.dot(v) * n;
  }
  l.rows = 3;
  if (!(w.tilt > 0.0)) return;
  const Eigen::Vector3d axis = pose.face.rotation.col(2);
  const Eigen::Vector3d turn = rotation_between(axis, -n);
  const double angle = turn.norm();
  const double beyond = std::max(angle - w.free_tilt_rad, 0.0);
  if (!(beyond > 0.0)) return;
  l.rows = 6;
  const double tilt_scale = w.tilt * kMetresPerRadian;
  l.error.tail<3>() = angle > 0.0 ? Eigen::Vector3d(turn * (tilt_scale * beyond / angle)) : Eigen::Vector3d::Zero();
  for (Eigen::Index i = 0; i < l.J.cols(); ++i) {
    const Eigen::Vector3d spin = l.J.col(i).tail<3>();
    l.J.col(i).tail<3>() = tilt_scale * (spin - axis * axis.dot(spin));  // spin about the axis is free
  }
}

/// x := A^-1 x by Cholesky's factors, of which A (lower triangle) is overwritten. False if A is not positive definite.
bool solve_positive(JointMatrix& A, JointVector& x) {
  const Eigen::Index n = x.size();
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) {
      double sum = A(i, j);
      for (Eigen::Index k = 0; k < j; ++k) sum -= A(i, k) * A(j, k);
      if (j < i) {
        A(i, j) = sum / A(j, j);
      } else if (sum > 0.0) {
        A(i, i) = std::sqrt(sum);
      } else {
        return false;
      }
    }
    for (Eigen::Index k = 0; k < i; ++k) x[i] -= A(i, k) * x[k];
    x[i] /= A(i, i);
  }
  for (Eigen::Index i = n; i-- > 0;) {
    for (Eigen::Index k = i + 1; k < n; ++k) x[i] -= A(k, i) * x[k];
    x[i] /= A(i, i);
  }
  return true;
}

/// Levenberg-Marquardt within joint limits: steps are clamped, joints at a limit that push outwards are left out.
JointVector descend(const Problem& problem, JointVector q, const Weights& weights, int iterations) {
  const Eigen::Index n = q.size();
  double damping = 1e-3;
  Linearised at_q;
  Linearised at_candidate;
  linearise(problem, q, weights, at_q);
  double cost = at_q.error.head(at_q.rows).squaredNorm();
  for (int k = 0; k < iterations && cost > 1e-22; ++k) {
    JointVector gradient(n);
    JointMatrix A(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto column = at_q.J.col(i).head(at_q.rows);
      gradient[i] = column.dot(at_q.error.head(at_q.rows));
      for (Eigen::Index j = 0; j <= i; ++j) A(i, j) = column.dot(at_q.J.col(j).head(at_q.rows));
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const bool stuck =
          (q[i] <= problem.lower[i] && gradient[i] < 0.0) || (q[i] >= problem.upper[i] && gradient[i] > 0.0);
      if (!stuck) continue;
      gradient[i] = 0.0;
      A.row(i).head(i).setZero();
      A.col(i).tail(n - i).setZero();
    }
    if (largest_magnitude(gradient) < 1e-16) break;
    A.diagonal().array() += damping;
    JointVector step = gradient;
    if (!solve_positive(A, step)) {
      damping = std::max(8.0 * damping, 1e-12);
      if (damping > 1e6) break;
      continue;
    }
    const double longest = largest_magnitude(step);
    if (!(longest < 1e3)) break;
    if (longest > 0.6) step *= 0.6 / longest;
    const JointVector candidate = problem.clamped(q + step);
    linearise(problem, candidate, weights, at_candidate);
    const double candidate_cost = at_candidate.error.head(at_candidate.rows).squaredNorm();
    if (candidate_cost < cost) {
      const bool done = cost - candidate_cost < 1e-14 * cost && damping < 1e-10;
      q = candidate;
      std::swap(at_q, at_candidate);
      cost = candidate_cost;
      damping = std::max(damping * 0.2, 1e-14);
      if (done) break;
    } else {
      damping *= 8.0;
      if (damping > 1e6) break;
    }
  }
  return q;
}

bool on_point(const FaceSolution& s) {
  return std::abs(s.normal_error_m) <= kPositionTolerance && s.lateral_error_m <= kPositionTolerance;
}

/// Position alone, exact if it can be; else exact along the normal and as near as it gets sideways.
FaceSolution finish(const Problem& problem, const JointVector& start) {
  JointVector q = descend(problem, start, {1.0, 1.0, 0.0, 0.0}, kIterations);
  const FaceSolution found = problem.assess(q);
  if (on_point(found) || !(problem.target.max_lateral_m > 0.0)) return found;
  // Only a point just out of reach is worth the search for a place beside it.
  if (std::hypot(found.normal_error_m, found.lateral_error_m) > kOffCentreSearch * problem.target.max_lateral_m) {
    return found;
  }
  q = descend(problem, q, {100.0, 1.0, 0.0, 0.0}, kIterations);
  q = descend(problem, q, {1.0, 0.0, 0.0, 0.0}, kIterations);
  const FaceSolution off_centre = problem.assess(q);
  return off_centre.lateral_error_m <= problem.target.max_lateral_m ? off_centre : found;
}

/// From a start to a solution: tilt first counts in full, then only beyond what is allowed, at last not at all.
FaceSolution search(const Problem& problem, const JointVector& start) {
  JointVector q = descend(problem, problem.clamped(start), {1.0, 1.0, 1.0, 0.0}, kIterations / 2);
  q = descend(problem, q, {1.0, 1.0, 1.0, 0.8 * problem.target.max_tilt_rad}, kIterations / 2);
  return finish(problem, q);
}

bool accepted(const FaceTarget& target, const FaceSolution& s) {
  return std::abs(s.normal_error_m) <= kPositionTolerance &&
         s.lateral_error_m <= std::max(target.max_lateral_m, kPositionTolerance) && s.tilt_rad <= target.max_tilt_rad;
}

double badness(const FaceTarget& target, const FaceSolution& s) {
  return std::hypot(s.normal_error_m, s.lateral_error_m) +
         kMetresPerRadian * std::max(s.tilt_rad - target.max_tilt_rad, 0.0);
}

double distance(const JointVector& a, const JointVector& b) { return largest_magnitude(a - b); }

/// Unit joint motion that moves neither face nor its axis, nearest to `wish`; zero if there is none.
JointVector null_motion(const Problem& problem, const JointVector& q, const JointVector& wish) {
  Linearised l;
  linearise(problem, q, {1.0, 1.0, 1.0, -1.0}, l);
  JointMatrix A = l.J.transpose().lazyProduct(l.J);
  A.diagonal().array() += 1e-9;
  const Residual moved = l.J.lazyProduct(wish);
  JointVector pull = l.J.transpose().lazyProduct(moved);
  if (!solve_positive(A, pull)) return JointVector::Zero(q.size());
  JointVector motion = wish - pull;
  const double size = largest_magnitude(motion);
  if (!(size > 1e-3)) return JointVector::Zero(q.size());
  return motion / size;
}

class Collection {
 public:
  Collection(const Problem& problem, const IkOptions& options, double apart)
      : problem_(problem), options_(options), apart_(apart) {}

  void enter(const FaceSolution& s) {
    if (!s.q.allFinite()) return;
    if (!accepted(problem_.target, s)) {
      if (closest_.q.size() == 0 || badness(problem_.target, s) < badness(problem_.target, closest_)) closest_ = s;
      return;
    }
    if (full()) return;
    for (const FaceSolution& other : found_) {
      if (distance(other.q, s.q) < apart_) return;
    }
    found_.push_back(s);
  }
  [[nodiscard]] bool full() const { return static_cast<int>(found_.size()) >= options_.max_solutions; }
  [[nodiscard]] std::vector<FaceSolution>& found() { return found_; }
  [[nodiscard]] const FaceSolution& closest() const { return closest_; }

 private:
  const Problem& problem_;
  const IkOptions& options_;
  double apart_;
  std::vector<FaceSolution> found_;
  FaceSolution closest_;
};

/// Whether more starts would show more: after `starts` of them found `found` solutions, the expected number of all is
/// found (starts - 1) / (starts - found - 2) (Boender and Rinnooy Kan, Math. Programming 37, 1987).
bool nothing_left(int found, int starts) {
  const double left = starts - found - 2.0;
  return found > 0 && left > 0.0 && found * (starts - 1.0) / left < found + 0.5;
}

Problem make_problem(const RobotDescription& robot, const Chain& chain, const FaceTarget& target) {
  const int n = chain.dof();
  Problem problem{chain, target, JointVector(n), JointVector(n)};
  for (int i = 0; i < n; ++i) {
    const JointLimits& limits = robot.joints[static_cast<std::size_t>(i)].limits;
    const double margin = std::min(kLimitMargin, 0.25 * (limits.upper_rad - limits.lower_rad));
    problem.lower[i] = limits.lower_rad + margin;
    problem.upper[i] = limits.upper_rad - margin;
  }
  return problem;
}

std::string unreachable(const FaceTarget& target, const FaceSolution& closest) {
  const double off_mm = 1e3 * std::hypot(closest.normal_error_m, closest.lateral_error_m);
  const double tilt_deg = closest.tilt_rad * 180.0 / std::numbers::pi;
  const double allowed_deg = target.max_tilt_rad * 180.0 / std::numbers::pi;
  return fmt::format(
      "the point ({:.4f}, {:.4f}, {:.4f}) m cannot be reached: the closest pose within joint limits is {:.2f} mm away "
      "and tilted by {:.2f} deg ({:.2f} deg allowed)",
      target.position_m.x(), target.position_m.y(), target.position_m.z(), off_mm, tilt_deg, allowed_deg);
}

}  // namespace

IkResult solve_face_on_point(const RobotDescription& robot, const Chain& chain, const FaceTarget& target,
                             const JointVector& near, const IkOptions& options) {
  const int n = chain.dof();
  const Problem problem = make_problem(robot, chain, target);
  const bool redundant = n > 5 || n == 4;  // four joints: the tilt allowed leaves them a little freedom
  Collection collection(problem, options, redundant ? options.distinct_rad : options.same_rad);
  Random random(options.seed);

  const auto try_from = [&](const JointVector& start) {
    // Three joints or fewer have to take the tilt they get.
    if (n > 3) collection.enter(search(problem, start));
    // Looking at tilt draws an arm with few joints to the stretched pose between two solutions: look for them without.
    if (n < 5) collection.enter(finish(problem, problem.clamped(start)));
  };
  try_from(near);
  try_from(JointVector::Zero(n));
  try_from(0.5 * (problem.lower + problem.upper));
  // Starts fill the joint space evenly (additive recurrence of Roberts, 2018), shifted by the seed.
  double ratio = 2.0;
  for (int k = 0; k < 40; ++k) ratio = std::pow(1.0 + ratio, 1.0 / (n + 1.0));
  JointVector place(n);
  JointVector stride(n);
  for (int i = 0; i < n; ++i) {
    place[i] = random.uniform(0.0, 1.0);
    stride[i] = std::pow(ratio, -(i + 1.0));
  }
  for (int k = 0; k < options.starts && !collection.full(); ++k) {
    if (!redundant && k >= kLeastStarts && nothing_left(static_cast<int>(collection.found().size()), k)) break;
    JointVector start(n);
    for (int i = 0; i < n; ++i) {
      place[i] += stride[i];
      if (place[i] >= 1.0) place[i] -= 1.0;
      start[i] = problem.lower[i] + place[i] * (problem.upper[i] - problem.lower[i]);
    }
    try_from(start);
  }

  // A redundant arm moves on along its null space from everything found so far.
  const std::size_t isolated = collection.found().size();
  for (std::size_t k = 0; redundant && k < isolated && !collection.full(); ++k) {
    JointVector wish(n);
    for (int i = 0; i < n; ++i) wish[i] = random.uniform(-1.0, 1.0);
    for (const double way : {1.0, -1.0}) {
      JointVector q = collection.found()[k].q;
      JointVector heading = way * wish;
      for (int step = 0; step < options.null_space_steps && !collection.full(); ++step) {
        const JointVector motion = null_motion(problem, q, heading);
        if (motion.isZero()) break;
        const FaceSolution next = search(problem, q + options.null_space_step_rad * motion);
        if (!accepted(target, next)) break;
        collection.enter(next);
        q = next.q;
        heading = motion;
      }
    }
  }

  IkResult result;
  result.solutions = std::move(collection.found());
  std::stable_sort(result.solutions.begin(), result.solutions.end(), [&](const FaceSolution& a, const FaceSolution& b) {
    return distance(a.q, near) < distance(b.q, near);
  });
  // Struck off centre only if the centre itself is out of reach.
  if (std::any_of(result.solutions.begin(), result.solutions.end(), on_point)) {
    std::erase_if(result.solutions, [](const FaceSolution& s) { return !on_point(s); });
  } else if (!result.solutions.empty()) {
    double least = result.solutions.front().lateral_error_m;
    for (const FaceSolution& s : result.solutions) least = std::min(least, s.lateral_error_m);
    std::erase_if(result.solutions, [&](const FaceSolution& s) { return s.lateral_error_m > least + 2e-4; });
  } else {
    result.closest = collection.closest();
    result.why = unreachable(target, result.closest);
  }
  return result;
}

std::optional<FaceSolution> solve_near(const RobotDescription& robot, const Chain& chain, const FaceTarget& target,
                                       const JointVector& q) {
  const Problem problem = make_problem(robot, chain, target);
  const FaceSolution found =
      chain.dof() < 5 ? finish(problem, problem.clamped(q)) : search(problem, problem.clamped(q));
  if (!found.q.allFinite() || !on_point(found) || !accepted(target, found)) return std::nullopt;
  return found;
}

}  // namespace mrr::sup
