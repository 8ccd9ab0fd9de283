#include "module_fw/control/friction_identification.h"

namespace mrr::fw {

namespace {

constexpr float kSlowest_rad_s = 5e-3F;
constexpr float kMargin_rad = 0.01F;       // from the position limits
constexpr float kLeastRoom_rad = 0.08F;    // to either side
constexpr float kSettle = 0.3F;            // share of a motor turn before a slow pass counts
constexpr float kOnSpeed = 0.1F;           // share of the speed within which it is reached
constexpr float kTurnSpeed_rad_s = 0.15F;  // from it on the Stribeck effect is over, and a turn can be averaged
constexpr float kBentFrom_rad_s = 0.01F;
constexpr float kSpread = 0.25F;       // of the speed, rms
constexpr float kNoise_rad_s = 3e-3F;  // of the velocity reading, rms
constexpr int kTurnTicks = 12;
constexpr int kLeastTicks = 40;
constexpr float kTurnWeight = 0.25F;
constexpr float kLoadRidge = 1e-4F;  // passes that all lie about one place say nothing of slope and curvature
constexpr float kSlowestDecay = 20.0F;
constexpr float kCoarseFactor = 1.35F;
constexpr float kFineFactor = 1.06F;

float power(float base, int n) noexcept {
  float x = 1.0F;
  for (; n > 0; --n) x *= base;
  for (; n < 0; ++n) x /= base;
  return x;
}

// Without libm: the root of x by Newton's method, from above.
float root(float x) noexcept {
  if (!(x > 0.0F)) return 0.0F;
  float r = x > 1.0F ? x : 1.0F;
  for (int i = 0; i < 24; ++i) r = 0.5F * (r + x / r);
  return r;
}

// Cholesky. Only the lower half of A is read; x is the right-hand side, and then the solution.
template <std::size_t N>
bool solve_symmetric(std::array<std::array<float, N>, N>& A, std::array<float, N>& x) noexcept {
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      float sum = A[i][j];
      for (std::size_t m = 0; m < j; ++m) sum -= A[i][m] * A[j][m];
      if (i != j) {
        A[i][j] = sum / A[j][j];
      } else {
        if (!(sum > 0.0F)) return false;
        A[i][i] = root(sum);
      }
    }
  }
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t m = 0; m < i; ++m) x[i] -= A[i][m] * x[m];
    x[i] /= A[i][i];
  }
  for (std::size_t i = N; i-- > 0;) {
    for (std::size_t m = i + 1; m < N; ++m) x[i] -= A[m][i] * x[m];
    x[i] /= A[i][i];
  }
  return true;
}

}  // namespace

void FrictionIdentification::start(const Setup& setup, float position_rad) noexcept {
  setup_ = setup;
  points_.clear();
  fitting_ = false;
  result_ = {};
  centre_rad_ = position_rad;
  const float up = setup.upper_rad - kMargin_rad - position_rad;
  const float down = position_rad - setup.lower_rad - kMargin_rad;
  const float room = up < down ? up : down;
  half_span_rad_ = room < setup.travel_rad ? room : setup.travel_rad;
  if (!(half_span_rad_ >= kLeastRoom_rad)) {
    state_ = State::no_room;
    return;
  }
  // A quarter of the way to speed up, half of it at speed, a quarter to slow down.
  const float by_room = root(setup.acceleration_rad_s2 * half_span_rad_);
  const float fastest = setup.speed_rad_s < by_room ? setup.speed_rad_s : by_room;
  slowest_ = kSlowest_rad_s < 0.1F * fastest ? kSlowest_rad_s : 0.1F * fastest;
  // Equal steps of the logarithm, by bisection.
  float low = 1.0F;
  float high = 10.0F;
  for (int i = 0; i < 30; ++i) {
    const float middle = 0.5F * (low + high);
    (slowest_ * power(middle, kLevels - 1) < fastest ? low : high) = middle;
  }
  ratio_ = low;
  level_ = pass_ = 0;
  speed_ = slowest_;
  direction_ = 1.0F;
  state_ = State::running;
  begin_pass();
}

// The fastest for its turns; where the Stribeck effect bends the curve, thrice.
int FrictionIdentification::passes(int level) const noexcept {
  if (level == kLevels - 1) return 2 * kRepetitions;
  const float speed = slowest_ * power(ratio_, level);
  return speed > kBentFrom_rad_s && speed < kTurnSpeed_rad_s ? 6 : 2;
}

void FrictionIdentification::begin_pass() noexcept {
  at_speed_ = false;
  steady_ = {};
  turn_ = {};
}

std::uint8_t FrictionIdentification::progress_percent() const noexcept {
  if (state_ == State::done || state_ == State::poor_fit) return 100;
  if (!running()) return 0;
  if (fitting_) return 99;
  // The passes take ever less time: the first two levels are half of it.
  float left = 0.0F;
  float all = 0.0F;
  for (int k = 0; k < kLevels; ++k) {
    const float time = static_cast<float>(passes(k)) * power(1.0F / ratio_, k);
    all += time;
    if (k >= level_) left += time;
  }
  return static_cast<std::uint8_t>(98.0F * (1.0F - left / all));
}

void FrictionIdentification::close(Average& average, float last_velocity, float weight) noexcept {
  if (average.n > 1) {
    const float share = 1.0F / static_cast<float>(average.n);
    Point p = average.sum;
    p.velocity *= share;
    p.velocity_squared *= share;
    p.position *= share;
    p.position_squared *= share;
    p.current *= share;
    p.load *= share;
    p.acceleration = (last_velocity - average.first_velocity) / (static_cast<float>(average.n - 1) * setup_.dt_s);
    p.weight = weight;
    // A steady pass that stuck and slipped has no one speed: it says nothing.
    const float spread = p.velocity_squared - p.velocity * p.velocity;
    const float allowed = kSpread * kSpread * p.velocity * p.velocity + kNoise_rad_s * kNoise_rad_s;
    if (weight < 1.0F || spread <= allowed) (void)points_.push_back(p);
  }
  average = {};
}

void FrictionIdentification::collect(const Sample& s) noexcept {
  const auto add = [&](Average& to) {
    if (to.n == 0) to.first_velocity = s.velocity_rad_s;
    const float position = (s.position_rad - centre_rad_) / half_span_rad_;
    to.sum.position += position;
    to.sum.position_squared += position * position;
    to.sum.velocity += s.velocity_rad_s;
    to.sum.velocity_squared += s.velocity_rad_s * s.velocity_rad_s;
    to.sum.current += s.current_a;
    to.sum.load += s.load_nm;
    ++to.n;
  };
  const float v = s.velocity_rad_s * direction_;
  if (!at_speed_ && v >= (1.0F - kOnSpeed) * speed_) {
    at_speed_ = true;
    from_rad_ = s.position_rad;
  }
  if (at_speed_) {
    // The first part of a pass is for the reference and the friction to settle.
    const float passed = direction_ * (s.position_rad - from_rad_);
    if (passed > kSettle * motor_turn()) add(steady_);
    return;
  }
  // Turning round at speed; both signs of the velocity, not the middle. Without a torque sensor nobody knows what the
  // link asks for then.
  if (!setup_.load_measured) return;
  const bool counts = speed_ > 1.5F * kTurnSpeed_rad_s && absolute(v) > kTurnSpeed_rad_s;
  if (counts && (turn_.n == 0 || turn_.first_velocity * s.velocity_rad_s > 0.0F)) {
    add(turn_);
    if (turn_.n >= kTurnTicks) close(turn_, s.velocity_rad_s, kTurnWeight);
  } else {
    turn_ = {};
  }
}

void FrictionIdentification::update(const Sample& sample) noexcept {
  if (!running()) return;
  if (fitting_) return fit_step();
  if (!sample.valid) {
    state_ = State::no_fit;
    return;
  }
  collect(sample);

  // The end of a pass: at the side, or, when slow, after a motor turn.
  const float stopping = 0.5F * speed_ * speed_ / setup_.acceleration_rad_s2;
  const float beyond = direction_ * (sample.position_rad - centre_rad_) + stopping;
  const bool slow = stopping < 0.05F * half_span_rad_;
  const bool enough = at_speed_ && direction_ * (sample.position_rad - from_rad_) > (1.0F + kSettle) * motor_turn();
  if (!(beyond >= half_span_rad_ || (slow && enough))) return;

  if (steady_.n >= kLeastTicks) close(steady_, sample.velocity_rad_s, 1.0F);
  begin_pass();
  direction_ = -direction_;
  if (++pass_ < passes(level_)) return;
  pass_ = 0;
  if (++level_ < kLevels) {
    speed_ = slowest_ * power(ratio_, level_);
    return;
  }
  if (setup_.load_measured) smooth_load();
  fitting_ = true;
  candidate_ = 0;
  best_ = {};
  if (points_.size() < 2 * kUnknowns) state_ = State::no_fit;
}

// The load of the passes by the parabola through them, and by what is left of acceleration in them.
void FrictionIdentification::smooth_load() noexcept {
  constexpr std::size_t kN = 4;
  const auto row_of = [](const Point& p) {
    return std::array<float, kN>{1.0F, p.position, p.position_squared, p.acceleration};
  };
  std::array<std::array<float, kN>, kN> A{};
  std::array<float, kN> x{};
  const auto is_pass = [](const Point& p) { return p.weight >= 1.0F; };
  for (const Point& p : points_) {
    if (!is_pass(p)) continue;
    const std::array<float, kN> row = row_of(p);
    for (std::size_t i = 0; i < kN; ++i) {
      x[i] += row[i] * p.load;
      for (std::size_t j = 0; j <= i; ++j) A[i][j] += row[i] * row[j];
    }
  }
  for (std::size_t i = 0; i < kN; ++i) A[i][i] += kLoadRidge;
  if (!solve_symmetric(A, x)) return;
  for (Point& p : points_) {
    if (!is_pass(p)) continue;
    const std::array<float, kN> row = row_of(p);
    p.load = 0.0F;
    for (std::size_t i = 0; i < kN; ++i) p.load += x[i] * row[i];
  }
}

// One point as a line of the least squares, in shares of the rough f_c. Unknowns, all of order one: the torque
// constants over their nominal values; f_c, f_s - f_c, b of either direction. Without a torque sensor the torque
// constants are believed and friction is the same both ways (else it could not be told from a load); instead the load
// is found that 60B2h does not tell of: a parabola in the position, and the inertia of what hangs on the joint.
float FrictionIdentification::fill_row(const Point& p, float decay, Row& row) const noexcept {
  const float per_nm = 1.0F / setup_.coulomb_nm;
  const std::size_t k = p.current >= 0.0F ? 0 : 1;
  const float motor = setup_.gear_ratio * setup_.torque_constant[k] * p.current * per_nm;
  const float load = (p.load + setup_.inertia_kg_m2 * p.acceleration) * per_nm;
  const std::size_t way = p.velocity >= 0.0F ? 0 : 1;
  const std::size_t at = setup_.load_measured ? kFriction[way] : kFriction[0];
  const float s = way == 0 ? -1.0F : 1.0F;
  row[at] = s;
  row[at + 1] = s * exp_negative(decay * p.velocity_squared);
  row[at + 2] = s * absolute(p.velocity);
  if (setup_.load_measured) {
    row[k] = motor;
    return load;
  }
  row[0] = -1.0F;
  row[1] = -p.position;
  row[kFriction[1]] = -p.position_squared;
  row[kFriction[1] + 1] = -p.acceleration;
  return load - motor;
}

// Least squares for a given f_tau.
FrictionIdentification::Solution FrictionIdentification::solve(float decay) const noexcept {
  constexpr std::size_t kN = kUnknowns;
  std::array<std::array<float, kN>, kN> A{};
  std::array<float, kN> g{};
  float yy = 0.0F;
  for (const Point& p : points_) {
    std::array<float, kN> row{};
    const float y = fill_row(p, decay, row);
    for (std::size_t i = 0; i < kN; ++i) {
      const float wi = p.weight * row[i];
      if (wi == 0.0F) continue;
      g[i] += wi * y;
      for (std::size_t j = 0; j <= i; ++j) A[i][j] += wi * row[j];
    }
    yy += p.weight * y * y;
  }
  // What the data say nothing about stays at its nominal value: 1 for the torque constants, nothing for the rest.
  for (std::size_t i = 0; i < kN; ++i) {
    const bool constant = setup_.load_measured && i < 2;
    const float ridge = constant ? 1e-3F : 1e-5F;
    A[i][i] += ridge;
    if (constant) g[i] += ridge;
  }
  Solution solution;
  solution.x = g;
  if (!solve_symmetric(A, solution.x)) return solution;
  // The cost anew from the residuals: as a difference of large sums it would be rounding.
  float cost = 0.0F;
  for (const Point& p : points_) {
    std::array<float, kN> row{};
    float r = -fill_row(p, decay, row);
    for (std::size_t i = 0; i < kN; ++i) r += row[i] * solution.x[i];
    cost += p.weight * r * r;
  }
  if (is_finite(cost)) solution.cost = cost;
  return solution;
}

void FrictionIdentification::fit_step() noexcept {
  const int fine = candidate_ - kCoarse;
  if (fine >= kFine) return finish();
  if (fine == 0) middle_ = decay_;
  const float decay =
      fine < 0 ? kSlowestDecay * power(kCoarseFactor, candidate_) : middle_ * power(kFineFactor, fine - kFine / 2);
  ++candidate_;
  const Solution s = solve(decay);
  if (s.cost >= 0.0F && (best_.cost < 0.0F || s.cost < best_.cost)) {
    best_ = s;
    decay_ = decay;
  }
}

void FrictionIdentification::finish() noexcept {
  if (best_.cost < 0.0F) {
    state_ = State::no_fit;
    return;
  }
  const float f = setup_.coulomb_nm;
  for (std::size_t way = 0; way < 2; ++way) {
    const std::size_t at = setup_.load_measured ? kFriction[way] : kFriction[0];
    const float coulomb = best_.x[at] * f;
    const float above = best_.x[at + 1] * f;
    const float viscous = best_.x[at + 2] * f;
    result_.friction[way] = {coulomb, coulomb + (above > 0.0F ? above : 0.0F), decay_, viscous > 0.0F ? viscous : 0.0F};
    result_.torque_constant[way] = setup_.torque_constant[way] * (setup_.load_measured ? best_.x[way] : 1.0F);
  }
  float weight = 0.0F;
  for (const Point& p : points_) weight += p.weight;
  result_.residual_nm = f * root(best_.cost / weight);
  result_.points = static_cast<std::uint16_t>(points_.size());
  const float mean_coulomb = 0.5F * (result_.friction[0][0] + result_.friction[1][0]);
  state_ =
      mean_coulomb > 0.0F && result_.residual_nm <= setup_.max_residual * mean_coulomb ? State::done : State::poor_fit;
}

}  // namespace mrr::fw
