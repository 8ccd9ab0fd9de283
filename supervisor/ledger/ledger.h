// Room: supervisor/ledger. What every blow cost the gear of every joint: counts, uses, share of its life.
// May touch common/, supervisor/impact and what a swing reports. No I/O here; see ledger_file.h.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "supervisor/impact/external.h"
#include "supervisor/strike/session.h"

namespace mrr::sup {

/// What a drive's catalogue gives three torques for.
enum class LoadLimit : std::uint8_t { rated, repeated_peak, momentary_peak };
inline constexpr std::size_t kLoadLimits = 3;
inline constexpr std::size_t kPulseShapes = 2;
[[nodiscard]] double limit_nm(const TransmissionDescription& drive, LoadLimit limit) noexcept;

/// One blow as one transmission felt it, joint side. Magnitudes.
struct BlowLoad {
  double contact_s = 0.0;
  double peak_nm = 0.0;
  double impulse_nm_s = 0.0;  ///< integral of the torque over the contact
  double speed_rad_s = 0.0;   ///< of the joint as the contact began
};

/// The account of one transmission. Only grows.
struct JointLedger {
  std::uint64_t blows = 0;    ///< that touched something
  std::uint64_t unknown = 0;  ///< of these, those whose load nobody saw: what is below is then a least
  /// Blows with a peak above each limit. Above the repeated peak: a momentary-torque event, of which a drive stands a
  /// limited number; above the momentary peak: none is allowed.
  std::array<std::uint64_t, kLoadLimits> peaks_over{};
  /// Blows with an impulse above each limit's, by PulseShape.
  std::array<std::array<std::uint64_t, kLoadLimits>, kPulseShapes> impulses_over{};
  double largest_peak_nm = 0.0;
  double largest_impulse_nm_s = 0.0;
  /// Largest impulse over the rated torque's in the same time, a square pulse. Of another limit: times rated over it;
  /// of a half-sine: times pi/2. See use().
  double largest_rated_use = 0.0;
  double momentary_life = 0.0;  ///< share of the momentary-torque events of a life, (56)
  double wear_life = 0.0;       ///< share of the rated life of the wave generator's bearing, while in contact

  [[nodiscard]] std::uint64_t momentary_events() const noexcept { return peaks_over[1]; }
  [[nodiscard]] double life_share() const noexcept { return momentary_life + wear_life; }
  /// Largest impulse so far over what `limit` allows in its time; 1 is all of it.
  [[nodiscard]] double use(const TransmissionDescription& drive, LoadLimit limit, PulseShape shape) const noexcept;
  void enter(const TransmissionDescription& drive, const BlowLoad& load) noexcept;
};

/// Share of a drive's life that a momentary-torque event costs: 1/N of (56), and at least one stress cycle of 1e4.
[[nodiscard]] double momentary_share(double gear_ratio, const BlowLoad& load) noexcept;
/// Share of the rated life: turns of the wave generator times the cube of mean torque over rated, of 7000 h at 2000 rpm
/// (L10 in the makers' catalogues of this class of drive).
[[nodiscard]] double wear_share(const TransmissionDescription& drive, const BlowLoad& load) noexcept;

struct Ledger {
  std::string since;  ///< day it was begun, "2026-01-31": what came before is not known
  std::vector<JointLedger> joints;
  /// Enters a swing; one that touched nothing leaves everything as it is. Returns whether it touched.
  bool enter(const RobotDescription& robot, const SwingReport& swing);
};

/// As the robot's own sensors saw it; NaN where a joint has no torque sensor.
[[nodiscard]] BlowLoad load_of(const RobotDescription& robot, const SwingReport& swing, int joint) noexcept;

/// Table for a terminal, units in it.
[[nodiscard]] std::string report(const RobotDescription& robot, const Ledger& ledger);

}  // namespace mrr::sup
