#include "supervisor/ledger/ledger.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "supervisor/impact/limits.h"

namespace mrr::sup {
namespace {

constexpr double kRatedLifeTurns = 7000.0 * 60.0 * 2000.0;  // of the wave generator
constexpr double kStressCycles = 1e4;                       // above the repeated peak, in a life

std::size_t at(int i) { return static_cast<std::size_t>(i); }
constexpr std::array kLimits{LoadLimit::rated, LoadLimit::repeated_peak, LoadLimit::momentary_peak};

}  // namespace

double limit_nm(const TransmissionDescription& drive, LoadLimit limit) noexcept {
  switch (limit) {
    case LoadLimit::rated:
      return drive.rated_nm;
    case LoadLimit::repeated_peak:
      return drive.repeated_peak_nm;
    case LoadLimit::momentary_peak:
      return drive.momentary_peak_nm;
  }
  return 0.0;
}

double JointLedger::use(const TransmissionDescription& drive, LoadLimit limit, PulseShape shape) const noexcept {
  const double square = largest_rated_use * drive.rated_nm / limit_nm(drive, limit);
  return shape == PulseShape::square ? square : 0.5 * std::numbers::pi * square;
}

double momentary_share(double gear_ratio, const BlowLoad& load) noexcept {
  const double motor_rpm = load.speed_rad_s * gear_ratio * 30.0 / std::numbers::pi;
  return std::max(1.0 / impact_count(motor_rpm, load.contact_s), 1.0 / kStressCycles);
}

double wear_share(const TransmissionDescription& drive, const BlowLoad& load) noexcept {
  // Mean of the cube is not seen; a half-sine has 4/(3 pi) of its peak's, more than the cube of its mean.
  const double turns = load.speed_rad_s * drive.gear_ratio * load.contact_s / (2.0 * std::numbers::pi);
  return 4.0 / (3.0 * std::numbers::pi) * std::pow(load.peak_nm / drive.rated_nm, 3.0) * turns / kRatedLifeTurns;
}

void JointLedger::enter(const TransmissionDescription& drive, const BlowLoad& load) noexcept {
  ++blows;
  const bool known = load.contact_s > 0.0 && load.peak_nm >= 0.0 && load.impulse_nm_s >= 0.0 &&
                     load.speed_rad_s >= 0.0 &&
                     std::isfinite(load.contact_s + load.peak_nm + load.impulse_nm_s + load.speed_rad_s);
  if (!known) {
    ++unknown;
    return;
  }
  for (std::size_t k = 0; k < kLoadLimits; ++k) {
    const double limit = limit_nm(drive, kLimits[k]);
    peaks_over[k] += load.peak_nm > limit ? 1U : 0U;
    for (const PulseShape shape : {PulseShape::square, PulseShape::half_sine}) {
      const bool over = load.impulse_nm_s > impulse_limit_nm_s(limit, load.contact_s, shape);
      impulses_over[static_cast<std::size_t>(shape)][k] += over ? 1U : 0U;
    }
  }
  largest_peak_nm = std::max(largest_peak_nm, load.peak_nm);
  largest_impulse_nm_s = std::max(largest_impulse_nm_s, load.impulse_nm_s);
  largest_rated_use = std::max(largest_rated_use, load.impulse_nm_s / (drive.rated_nm * load.contact_s));
  if (load.peak_nm > drive.repeated_peak_nm) momentary_life += momentary_share(drive.gear_ratio, load);
  wear_life += wear_share(drive, load);
}

BlowLoad load_of(const RobotDescription& robot, const SwingReport& swing, int joint) noexcept {
  const SwingOutcome& outcome = swing.outcome;
  const ContactReport& contact = outcome.contact;
  BlowLoad load;
  load.contact_s = (contact.end - contact.start).seconds();
  if (robot.joints[at(joint)].sensors.torque_sensor) {
    load.peak_nm = outcome.peak_torque_nm[at(joint)];
    load.impulse_nm_s = std::abs(outcome.axis_impulse_nm_s[at(joint)]);
  } else {
    load.peak_nm = load.impulse_nm_s = std::numeric_limits<double>::quiet_NaN();
  }
  const bool seen = contact.qd_before.size() > joint;
  load.speed_rad_s = seen ? std::abs(contact.qd_before[joint]) : std::numeric_limits<double>::quiet_NaN();
  return load;
}

bool Ledger::enter(const RobotDescription& robot, const SwingReport& swing) {
  if (swing.outcome.contact.phase == ContactPhase::none) return false;
  for (int i = 0; i < robot.dof(); ++i) {
    joints[at(i)].enter(robot.joints[at(i)].transmission, load_of(robot, swing, i));
  }
  return true;
}

std::string report(const RobotDescription& robot, const Ledger& ledger) {
  std::string text = fmt::format(
      "Ledger since {}\n"
      "                     momentary  peak     largest impulse, % of what is allowed   life\n"
      "  joint        blows    events    Nm     rated      rep.peak      momentary     used\n"
      "                                        square sine  square sine  square sine      %\n",
      ledger.since);
  for (int i = 0; i < robot.dof(); ++i) {
    const JointLedger& joint = ledger.joints[at(i)];
    const TransmissionDescription& drive = robot.joints[at(i)].transmission;
    text += fmt::format("  {:<12} {:>5} {:>9} {:>5.1f}  ", robot.joints[at(i)].name, joint.blows,
                        joint.momentary_events(), joint.largest_peak_nm);
    for (const LoadLimit limit : kLimits) {
      text += fmt::format("  {:>5.0f}{:>5.0f} ", 100.0 * joint.use(drive, limit, PulseShape::square),
                          100.0 * joint.use(drive, limit, PulseShape::half_sine));
    }
    text += fmt::format(" {:>6.2g}\n", 100.0 * joint.life_share());
    if (joint.unknown > 0) {
      text += fmt::format("               {} of the blows were not seen by a torque sensor: a least\n", joint.unknown);
    }
  }
  return text;
}

}  // namespace mrr::sup
