// Room: module_fw/control. Friction identification: a programmed motion, then a fit of Coulomb, static, Stribeck and
// viscous friction per direction, and of the torque constants if the load is measured.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <array>
#include <cstdint>

#include "common/core/containers.h"
#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

/// To and fro about where the joint starts, ever faster: at constant speed the motor carries friction and load, while
/// it turns round at speed inertia is added, which tells the torque constant from friction. Every pass is averaged over
/// at least one motor turn, so that what varies with the motor's angle cancels.
///   K(i) i - load - B a = s [f_c + (f_s - f_c) exp(-f_tau v^2) + b |v|],  s = sgn v, K by the sign of i.
/// Linear in all but f_tau, which is searched for, one candidate a tick.
/// At constant speed the load is gravity's, a smooth function of the position: a parabola through all passes stands for
/// it, which a torque sensor that wanders meanwhile hardly bends. Without a sensor that parabola is fitted too.
class FrictionIdentification {
 public:
  /// 0x2170:01
  enum class State : std::uint8_t { none, running, done, no_room, interrupted, no_fit, poor_fit };

  struct Setup {
    float gear_ratio = 1.0F;
    float inertia_kg_m2 = 0.0F;                 ///< B, joint side
    std::array<float, 2> torque_constant{};     ///< nominal, motor side, for positive, negative torque
    bool load_measured = false;                 ///< otherwise the torque constants are believed
    float coulomb_nm = 1.0F;                    ///< roughly; only scales the arithmetic
    float travel_rad = 0.3F;                    ///< to either side
    float lower_rad = -1.0F, upper_rad = 1.0F;  ///< never beyond
    float speed_rad_s = 1.0F;
    float acceleration_rad_s2 = 10.0F;
    float max_residual = 0.1F;  ///< share of f_c
    float dt_s = 1e-3F;
  };
  struct Sample {
    float position_rad = 0.0F;
    float velocity_rad_s = 0.0F;
    float current_a = 0.0F;
    float load_nm = 0.0F;
    bool valid = false;
  };
  /// Of one direction: f_c, f_s in Nm, f_tau in s^2/rad^2, b in Nm s/rad. f_tau is one for both: the drift of a torque
  /// sensor, which would spoil it in each by itself, is of opposite sign in the two.
  using Friction = std::array<float, 4>;
  struct Result {
    std::array<Friction, 2> friction{};      ///< motion in the positive, in the negative direction
    std::array<float, 2> torque_constant{};  ///< motor side, for positive, negative torque
    float residual_nm = 0.0F;                ///< rms
    std::uint16_t points = 0;
  };

  void start(const Setup& setup, float position_rad) noexcept;
  void abort() noexcept {
    if (running()) state_ = State::interrupted;
  }
  /// One tick while running.
  void update(const Sample& sample) noexcept;

  [[nodiscard]] State state() const noexcept { return state_; }
  [[nodiscard]] bool running() const noexcept { return state_ == State::running; }
  /// Velocity to move with; 0 when not moving (any more).
  [[nodiscard]] float velocity_rad_s() const noexcept { return running() && !fitting_ ? direction_ * speed_ : 0.0F; }
  [[nodiscard]] std::uint8_t progress_percent() const noexcept;
  /// Meaningful when done or poor_fit.
  [[nodiscard]] const Result& result() const noexcept { return result_; }

 private:
  static constexpr int kLevels = 13;      // of speed
  static constexpr int kRepetitions = 3;  // of the fastest, for its turns
  static constexpr std::size_t kPoints = 192;
  static constexpr std::size_t kUnknowns = 8;
  static constexpr std::array<std::size_t, 2> kFriction{2, 5};  // where f_c of a direction is among them
  static constexpr int kCoarse = 24;  // candidates of f_tau, a factor apart; then finer ones around the best
  static constexpr int kFine = 13;

  struct Point {
    float velocity = 0.0F, velocity_squared = 0.0F, acceleration = 0.0F, current = 0.0F, load = 0.0F, weight = 0.0F;
    float position = 0.0F, position_squared = 0.0F;  ///< from the centre, shares of the span; of passes
  };
  struct Average {
    Point sum;
    float first_velocity = 0.0F;
    int n = 0;
  };
  struct Solution {
    std::array<float, kUnknowns> x{};
    float cost = -1.0F;  ///< negative: none
  };

  [[nodiscard]] float motor_turn() const noexcept { return 2.0F * kPi / setup_.gear_ratio; }
  [[nodiscard]] int passes(int level) const noexcept;
  void begin_pass() noexcept;
  void collect(const Sample& sample) noexcept;
  void close(Average& average, float last_velocity, float weight) noexcept;
  void smooth_load() noexcept;
  void fit_step() noexcept;
  void finish() noexcept;
  using Row = std::array<float, kUnknowns>;
  float fill_row(const Point& point, float decay, Row& row) const noexcept;
  [[nodiscard]] Solution solve(float decay) const noexcept;

  Setup setup_;
  State state_ = State::none;
  float centre_rad_ = 0.0F;
  float half_span_rad_ = 0.0F;
  float direction_ = 1.0F;
  float speed_ = 0.0F;
  float slowest_ = 0.0F;
  float ratio_ = 1.0F;  ///< from one level to the next
  int level_ = 0;
  int pass_ = 0;
  bool at_speed_ = false;  ///< the turn before this pass is over
  float from_rad_ = 0.0F;  ///< where that was
  Average steady_;
  Average turn_;
  StaticVector<Point, kPoints> points_;

  bool fitting_ = false;
  int candidate_ = 0;
  float decay_ = 0.0F;
  float middle_ = 0.0F;  ///< of the finer search
  Solution best_;
  Result result_;
};

}  // namespace mrr::fw
