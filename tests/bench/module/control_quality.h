// Test support: how well a module's joint tracks, stands and yields on the emulated robot. The benchmark prints it as
// tables, tests hold slices of it. May touch everything that tests may.
#pragma once

#include <string>

#include "tests/bench/module/plant_joint.h"

namespace mrr::fw::test {

/// What a joint is led along; theory section 2 gives the errors for `sine`.
enum class Path { sine, slow_sine, swing };

struct QualityCase {
  int joint = 0;  ///< 0: base joint, 2: hammer joint
  Path path = Path::sine;
  double feedforward = 0.8;
  bool compensator = true;
  double friction = 1.0;      ///< true friction against the identified one
  double link_inertia = 1.0;  ///< true masses and inertias of the links
  double rotor_inertia = 1.0;
  double torque_bandwidth_hz = 200.0;
  double believed_bandwidth_hz = 0.0;  ///< what the module is told of it; 0: the truth
  double loop_hz = 1000.0;
  double sensor_lost_at_s = -1.0;  ///< from then on no reading of the torque sensor is fresh
  double model_error = 0.0;        ///< share by which the supervisor's model torque is wrong
  std::uint64_t seed = 0;
};

struct Tracking {
  bool completed = false;  ///< enabled, followed to the end, no fault
  std::string note;        ///< why not
  double rms_mrad = 0.0;   ///< gear output of the motor against the set points, after the first second
  double max_mrad = 0.0;
  double torque_rms_step_nm = 0.0;              ///< of the commanded torque from tick to tick: how much it rattles
  can::LimitCode limit = can::LimitCode::none;  ///< at the end
};

struct Standing {
  bool completed = false;
  double peak_to_peak_mrad = 0.0;       ///< of the motor, from one second after the stop
  double last_peak_to_peak_mrad = 0.0;  ///< over the last ten seconds: a limit cycle would show
  double last_torque_peak_to_peak_nm = 0.0;
  double said_to_swing = 0.0;  ///< share of that time in which the module's limit code was torque_swings
};

Tracking track(const QualityCase& c, double seconds = 8.0);
/// Half a period of the sine, then a stop and a hold of `hold_s`.
Standing stand(const QualityCase& c, double hold_s);

/// The reference's Table 2: the base joint, passive, turned by a hand that pushes ever harder.
/// @returns the hand's torque, Nm, at which the motor comes along (by 3 mrad, ten times what its friction gives
/// elastically); NaN if it never did.
double torque_to_turn(int joint, double direction, bool compensated, std::uint64_t seed = 0);

/// What a passive joint does under a hand.
struct PassiveCase {
  int joint = 0;
  double friction = 1.0;    ///< true friction against the identified one
  std::uint64_t seed = 1;   ///< of the hand, and of the plant's sensors
  double hand_share = 1.3;  ///< largest torque of the hand, of the static friction; 0: no hand
  double push_s = 0.12;     ///< mean time that one torque lasts
  bool compensated = true;
};
struct PassiveResult {
  bool completed = false;
  std::string note;
  double gained_j = 0.0;   ///< most that motor less friction ever put into the joint, since it was lowest
  double net_j = 0.0;      ///< motor less friction over the whole time
  double moved_rad = 0.0;  ///< largest motor motion from the start
  int phases = 0;
  double bristle_j = 0.0;   ///< what friction can store and give back
  int guarded = 0;          ///< passive phases that the guard ended the compensation of
  double observed_j = 0.0;  ///< most that the module saw
};
/// Passive phases in a row, for `seconds` of them.
PassiveResult push_about(const PassiveCase& c, double seconds);

}  // namespace mrr::fw::test
