// Test support: one joint with an elastic drive, LuGre friction, a current loop and raw sensors. Independent of the
// emulator's plant.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/core/random.h"
#include "module_fw/config.h"
#include "module_fw/joint_io.h"

namespace mrr::fw::test {

struct JointParameters {
  double rotor_kg_m2 = 0.1714;
  double link_kg_m2 = 0.37;
  double stiffness_nm_rad = 0.84e4;
  double damping_nm_s_rad = 12.0;
  double gravity_nm = 0.0;  ///< torque of gravity on the link: -gravity cos(q)
  double static_nm = 4.6;
  double coulomb_nm = 3.9;
  double stribeck_velocity_rad_s = 0.03;
  double viscous_nm_s_rad = 2.0;
  double presliding_rad = 2e-4;
  double current_bandwidth_hz = 400.0;
  double sensor_bandwidth_hz = 200.0;
  double torque_noise_nm = 0.05;
  double gear = 101.0;
  double brake_nm = 200.0;
};

/// Parameters of the reference's hammer joint and base joint (theory section 2).
inline JointParameters hammer_joint() { return {}; }
inline JointParameters base_joint() {
  JointParameters p;
  p.rotor_kg_m2 = 0.2972;
  p.link_kg_m2 = 1.4;
  p.stiffness_nm_rad = 2.7e4;
  p.static_nm = 36.2;
  p.coulomb_nm = 30.5;
  p.stribeck_velocity_rad_s = 0.05;
  p.viscous_nm_s_rad = 8.0;
  p.gear = 133.0;
  return p;
}

/// Firmware configuration with the gains of theory section 2.
inline ModuleConfig module_config(const JointParameters& p, bool base = false) {
  ModuleConfig c;
  c.sensing.torque_full_scale_nm = 100.0F;
  c.sensing.current_full_scale_a = 30.0F;
  c.drive.gear_ratio = static_cast<float>(p.gear);
  c.drive.torque_constant_positive_nm_a = base ? 0.16F : 0.22F;
  c.drive.torque_constant_negative_nm_a = base ? 0.16F : 0.22F;
  c.drive.peak_current_a = base ? 6.0F : 2.5F;
  c.drive.continuous_current_a = base ? 4.0F : 1.5F;
  c.drive.rated_torque_nm = base ? 47.0F : 16.0F;
  c.friction = {static_cast<float>(p.coulomb_nm), static_cast<float>(p.static_nm),
                static_cast<float>(1.0 / (p.stribeck_velocity_rad_s * p.stribeck_velocity_rad_s)),
                static_cast<float>(p.viscous_nm_s_rad)};
  ControlConfig& k = c.control;
  k.inertia_kg_m2 = static_cast<float>(p.rotor_kg_m2);
  k.lambda_1_s = 50.0F;
  k.position_gain_nm_rad = k.lambda_1_s * k.lambda_1_s * k.inertia_kg_m2;
  k.velocity_gain_nm_s_rad = 2.0F * k.lambda_1_s * k.inertia_kg_m2;
  if (base) {
    k.compensator = {true, {40, 800, 800, 0}, {6, 12, 12, 0}, {2, 4, 4, 40}, {0.25F, 0.3F, 0.3F, 2}, 2, 0.15F};
  } else {
    k.compensator = {true, {10, 300, 300, 0}, {2, 2.5F, 2.5F, 0}, {0.5F, 0.8F, 0.8F, 40}, {0.1F, 0.1F, 0.1F, 2}, 0.4F,
                     0.06F};
  }
  c.passive.compensation_nm = static_cast<float>(0.85 * p.coulomb_nm);
  c.passive.static_compensation_nm = static_cast<float>(0.85 * p.static_nm);
  c.limits.torque_nm = base ? 110.0F : 45.0F;
  c.limits.lower_rad = -2.5F;
  c.limits.upper_rad = 2.5F;
  return c;
}

class Joint {
 public:
  Joint(const JointParameters& parameters, const ModuleConfig& config, std::uint64_t seed)
      : p_(parameters), c_(config), random_(seed) {
    counts_per_rad_ = c_.sensing.encoder_counts_per_turn * p_.gear / (2.0 * M_PI);
  }
  void place(double q, double velocity = 0.0) {
    motor_q = link_q = q;
    motor_v = link_v = velocity;
    z_ = 0.0;
    link_q += load(q) / p_.stiffness_nm_rad;
    sensed_torque_ = transmission();
  }
  /// Advances by `dt_s`, the actuator command held.
  void step(double dt_s, const ActuatorCommand& command) {
    constexpr double h = 20e-6;
    const int n = static_cast<int>(std::lround(dt_s / h));
    const double kt = double{c_.drive.torque_constant_positive_nm_a};
    const double wanted =
        command.power_stage_enabled ? command.current_duty / 32767.0 * double{c_.sensing.current_full_scale_a} : 0.0;
    if (command.brake_release) {
      brake_timer_ += dt_s;
    } else {
      brake_timer_ = 0.0;
    }
    brake_released = brake_timer_ > 0.02;
    for (int i = 0; i < n; ++i) {
      current_ += h * 2.0 * M_PI * p_.current_bandwidth_hz * (wanted - current_);
      const double sigma0 = p_.coulomb_nm / p_.presliding_rad;
      const double sigma1 = 0.5 * std::sqrt(sigma0 * p_.rotor_kg_m2);
      const double ratio = motor_v / p_.stribeck_velocity_rad_s;
      const double g = p_.coulomb_nm + (p_.static_nm - p_.coulomb_nm) * std::exp(-ratio * ratio);
      const double dz = motor_v - std::abs(motor_v) * sigma0 * z_ / g;
      z_ += h * dz;
      friction = sigma0 * z_ + sigma1 * dz * std::exp(-ratio * ratio) + p_.viscous_nm_s_rad * motor_v;
      const double tau_s = transmission();
      const double tau = current_ * kt * p_.gear;
      const double external = external_nm;
      if (brake_released) {
        motor_v += h * (tau - tau_s - friction) / p_.rotor_kg_m2;
      } else {
        motor_v = 0.0;
        z_ = 0.0;
      }
      link_v += h * (tau_s + load(link_q) + external) / p_.link_kg_m2;
      motor_q += h * motor_v;
      link_q += h * link_v;
      sensed_torque_ += h * 2.0 * M_PI * p_.sensor_bandwidth_hz * (tau_s - sensed_torque_);
    }
  }
  RawSensors sample() {
    RawSensors raw;
    raw.encoder_count = static_cast<std::int32_t>(std::floor(motor_q * counts_per_rad_));
    raw.torque_adc = adc(sensed_torque_ + p_.torque_noise_nm * random_.normal(), c_.sensing.torque_full_scale_nm);
    raw.current_adc = adc(current_ + 0.01 * random_.normal(), c_.sensing.current_full_scale_a);
    raw.winding_temperature_adc = 350;
    raw.drive_temperature_adc = 300;
    raw.bus_voltage_adc = 4800;
    raw.inputs = brake_released ? kInputBrakeReleased : 0;
    raw.fresh = kFreshEncoder | kFreshTorque | kFreshCurrent | kFreshTemperature | kFreshBusVoltage;
    return raw;
  }
  [[nodiscard]] double transmission() const {
    return p_.stiffness_nm_rad * (motor_q - link_q) + p_.damping_nm_s_rad * (motor_v - link_v);
  }
  [[nodiscard]] double torque() const { return current_ * double{c_.drive.torque_constant_positive_nm_a} * p_.gear; }

  double motor_q = 0.0, motor_v = 0.0, link_q = 0.0, link_v = 0.0;
  double friction = 0.0;
  double external_nm = 0.0;
  bool brake_released = false;

 private:
  [[nodiscard]] double load(double q) const { return -p_.gravity_nm * std::cos(q); }
  static std::int16_t adc(double value, float full_scale_f) {
    const double full_scale = double{full_scale_f};
    return static_cast<std::int16_t>(std::lround(std::clamp(value / full_scale, -1.0, 1.0) * 32767.0));
  }
  JointParameters p_;
  ModuleConfig c_;
  Random random_;
  double counts_per_rad_;
  double z_ = 0.0;
  double current_ = 0.0;
  double sensed_torque_ = 0.0;
  double brake_timer_ = 0.0;
};

}  // namespace mrr::fw::test
