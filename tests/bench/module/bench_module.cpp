// How good the module's control is on the emulated robot, as tables: tracking, standing, robustness.
#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "tests/bench/module/control_quality.h"

namespace {

using namespace mrr::fw::test;  // NOLINT: a program of its own

struct JointGoal {
  const char* name;
  int joint;
  double goal_mrad;
};
constexpr JointGoal kJoints[] = {{"base joint", 0, 1.3}, {"hammer joint", 2, 0.5}};

const char* verdict(bool ok) { return ok ? "" : "  MISSED"; }

void print_tracking() {
  std::printf("\nTracking, rms error of the motor's gear output in mrad (largest in brackets)\n");
  std::printf("  %-14s %-11s %18s %18s %18s %6s\n", "", "path", "no feedforward", "20 % low", "and compensator",
              "goal");
  for (const JointGoal& j : kJoints) {
    for (const auto& [path, name] :
         {std::pair{Path::sine, "sine"}, {Path::slow_sine, "slow sine"}, {Path::swing, "swing"}}) {
      std::string cells;
      bool ok = false;
      for (const auto& [feedforward, compensator] : {std::pair{0.0, false}, {0.8, false}, {0.8, true}}) {
        QualityCase c;
        c.joint = j.joint;
        c.path = path;
        c.feedforward = feedforward;
        c.compensator = compensator;
        const Tracking t = track(c, path == Path::slow_sine ? 20.0 : 8.0);
        char cell[64];
        if (t.completed) {
          std::snprintf(cell, sizeof cell, " %9.2f (%6.2f)", t.rms_mrad, t.max_mrad);
        } else {
          std::snprintf(cell, sizeof cell, " %18s", t.note.c_str());
        }
        cells += cell;
        ok = t.completed && t.rms_mrad <= j.goal_mrad;
      }
      std::printf("  %-14s %-11s%s %6.1f%s\n", j.name, name, cells.c_str(), j.goal_mrad, verdict(ok));
    }
  }
}

void print_robustness() {
  struct Variation {
    const char* name;
    void (*apply)(QualityCase&);
  };
  const std::vector<Variation> variations{
      {"nominal", [](QualityCase&) {}},
      {"friction -50 %", [](QualityCase& c) { c.friction = 0.5; }},
      {"friction +50 %", [](QualityCase& c) { c.friction = 1.5; }},
      {"inertia -20 %", [](QualityCase& c) { c.link_inertia = c.rotor_inertia = 0.8; }},
      {"inertia +20 %", [](QualityCase& c) { c.link_inertia = c.rotor_inertia = 1.2; }},
      {"torque sensor 50 Hz", [](QualityCase& c) { c.torque_bandwidth_hz = 50; }},
      {"50 Hz, believed 60 Hz", [](QualityCase& c) { c.torque_bandwidth_hz = 50, c.believed_bandwidth_hz = 60; }},
      {"50 Hz, believed 200 Hz", [](QualityCase& c) { c.torque_bandwidth_hz = 50, c.believed_bandwidth_hz = 200; }},
      {"torque sensor 100 Hz", [](QualityCase& c) { c.torque_bandwidth_hz = 100; }},
      {"loop 500 Hz", [](QualityCase& c) { c.loop_hz = 500; }},
      {"loop 2 kHz", [](QualityCase& c) { c.loop_hz = 2000; }},
      {"loop 4 kHz", [](QualityCase& c) { c.loop_hz = 4000; }},
      {"sensor lost at 2 s", [](QualityCase& c) { c.sensor_lost_at_s = 2.0; }},
      {"lost, model 10 % low", [](QualityCase& c) { c.sensor_lost_at_s = 2.0, c.model_error = -0.1; }},
      // Corners: friction, inertia, sensor and loop at once.
      {"+50, -20 %, 50, 500 Hz",
       [](QualityCase& c) {
         c.friction = 1.5, c.link_inertia = c.rotor_inertia = 0.8, c.torque_bandwidth_hz = 50, c.loop_hz = 500;
       }},
      {"-50, -20 %, 50, 500 Hz",
       [](QualityCase& c) {
         c.friction = 0.5, c.link_inertia = c.rotor_inertia = 0.8, c.torque_bandwidth_hz = 50, c.loop_hz = 500;
       }},
      {"-50, +20 %, 50 Hz, 4 kHz",
       [](QualityCase& c) {
         c.friction = 0.5, c.link_inertia = c.rotor_inertia = 1.2, c.torque_bandwidth_hz = 50, c.loop_hz = 4000;
       }},
  };
  std::printf(
      "\nRobustness: feedforward as identified and compensator; what is true differs from what the module knows\n");
  std::printf("  %-22s %-14s %9s %9s %12s %12s %30s\n", "", "", "rms mrad", "max mrad", "rattle Nm", "hunting mrad",
              "torque p-p Nm  the module says");
  for (const Variation& v : variations) {
    for (const JointGoal& j : kJoints) {
      QualityCase c;
      c.joint = j.joint;
      c.feedforward = 1.0;
      v.apply(c);
      const Tracking t = track(c);
      if (!t.completed) {
        std::printf("  %-22s %-14s %s\n", v.name, j.name, t.note.c_str());
        continue;
      }
      QualityCase standing_case = c;
      standing_case.sensor_lost_at_s = -1.0;
      const Standing s = stand(standing_case, 11.0);
      const char* says = s.said_to_swing > 0.5 ? "torque_swings"
                         : t.limit == mrr::can::LimitCode::none
                             ? ""
                             : mrr::can::name_of_code(static_cast<std::uint16_t>(t.limit));
      std::printf("  %-22s %-14s %9.2f %9.2f %12.2f %12.3f %14.2f  %s%s\n", v.name, j.name, t.rms_mrad, t.max_mrad,
                  t.torque_rms_step_nm, s.peak_to_peak_mrad, s.last_torque_peak_to_peak_nm, says,
                  verdict(s.completed && s.peak_to_peak_mrad <= 1.0 && t.rms_mrad <= j.goal_mrad));
    }
  }
}

void print_standing() {
  std::printf("\nStanding still for 60 s after a move\n");
  std::printf("  %-14s %16s %22s %20s\n", "", "hunting p-p mrad", "last 10 s p-p mrad", "torque p-p Nm");
  for (const JointGoal& j : kJoints) {
    QualityCase c;
    c.joint = j.joint;
    const Standing s = stand(c, 60.0);
    std::printf("  %-14s %16.3f %22.3f %20.2f%s\n", j.name, s.peak_to_peak_mrad, s.last_peak_to_peak_mrad,
                s.last_torque_peak_to_peak_nm, verdict(s.completed && s.peak_to_peak_mrad <= 1.0));
  }
}

void print_passive() {
  std::printf("\nTurning the passive base joint by hand (the reference's Table 2), Nm\n");
  std::printf("  %-24s %10s %10s %12s %12s\n", "", "positive", "negative", "published +", "published -");
  const double without[] = {torque_to_turn(0, 1.0, false), torque_to_turn(0, -1.0, false)};
  const double with[] = {torque_to_turn(0, 1.0, true), torque_to_turn(0, -1.0, true)};
  std::printf("  %-24s %10.1f %10.1f %12.1f %12.1f\n", "without compensation", without[0], without[1], 36.3, 36.2);
  std::printf("  %-24s %10.1f %10.1f %12.1f %12.1f%s\n", "with compensation", with[0], with[1], 7.6, 5.7,
              verdict(with[0] <= 7.6 && with[1] <= 5.7));
  std::printf("  %-24s %8.0f %% %8.0f %% %10d %% %10d %%\n", "ratio", 100.0 * with[0] / without[0],
              100.0 * with[1] / without[1], 21, 16);

  std::printf("\nRandom hands on a passive joint: energy that compensation less friction put into it\n");
  std::printf("  %-14s %9s %12s %14s %12s %10s\n", "", "friction", "gained mJ", "bristles mJ", "net J", "guarded");
  for (const JointGoal& j : kJoints) {
    for (const double friction : {1.0, 0.9, 0.8, 0.7, 0.6, 0.5}) {
      PassiveResult all;
      for (std::uint64_t seed = 1; seed <= 4; ++seed) {
        const PassiveResult r = push_about({j.joint, friction, seed}, 8.0);
        if (!r.completed) std::printf("  %s\n", r.note.c_str());
        all.gained_j = std::max(all.gained_j, r.gained_j);
        all.bristle_j = r.bristle_j;
        all.net_j += r.net_j;
        all.guarded += r.guarded;
        all.phases += r.phases;
      }
      std::printf("  %-14s %7.0f %% %12.1f %14.1f %12.1f %5d/%d%s\n", j.name, 100.0 * friction, 1e3 * all.gained_j,
                  1e3 * all.bristle_j, all.net_j, all.guarded, all.phases, verdict(all.gained_j <= 0.05));
    }
  }
}

}  // namespace

int main() {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  print_tracking();
  print_standing();
  print_robustness();
  print_passive();
}
