#include "sim_vcan/world/swing_watch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "supervisor/impact/external.h"

namespace mrr::sim {

namespace {

constexpr double kMoved_m = 5e-5;  // less is below what a ruler shows: the effective mass is then infinite

}  // namespace

void SwingWatch::begin(const Plant& plant) {
  const auto dof = static_cast<std::size_t>(plant.dof());
  contacts_before_ = plant.contacts().size();
  height_before_m_ = plant.truth().nail_height_m;
  peak_swing_nm_.assign(dof, 0.0);
  passive_since_.assign(dof, Time{});
  was_passive_.assign(dof, false);
}

void SwingWatch::observe(const PlantTruth& truth) {
  for (std::size_t i = 0; i < peak_swing_nm_.size(); ++i)
    peak_swing_nm_[i] = std::max(peak_swing_nm_[i], std::abs(truth.transmission_torque_nm[i]));
}

void SwingWatch::passive_since(std::size_t joint, Time since) {
  if (was_passive_[joint]) return;
  was_passive_[joint] = true;
  passive_since_[joint] = since;
}

SwingTruth SwingWatch::conclude(const Plant& plant, std::uint32_t planned_passive) const {
  const std::size_t dof = peak_swing_nm_.size();
  const PlantTruth now = plant.truth();
  const ContactRecords& contacts = plant.contacts();
  SwingTruth truth;
  truth.nail_height_m = now.nail_height_m;
  truth.penetration_m = height_before_m_ - now.nail_height_m;
  truth.joints.resize(dof);
  // A blow may rebound: the contact with the largest impulse is the blow.
  const ContactRecord* blow = nullptr;
  for (std::size_t i = contacts_before_; i < contacts.size(); ++i) {
    if (blow == nullptr || contacts[i].impulse_n_s > blow->impulse_n_s) blow = &contacts[i];
  }
  for (std::size_t i = 0; i < dof; ++i) {
    truth.joints[i].passive = ((planned_passive >> i) & 1U) != 0;
    truth.joints[i].peak_torque_swing_nm = peak_swing_nm_[i];
    truth.joints[i].switch_lead_s = std::numeric_limits<double>::quiet_NaN();
  }
  if (blow == nullptr) return truth;
  truth.hit = true;
  truth.contact_start = blow->start;
  truth.contact_s = blow->duration().seconds();
  truth.impulse_n_s = blow->impulse_n_s;
  truth.peak_force_n = blow->peak_force_n;
  truth.speed_m_s = blow->speed_at_start_m_s;
  truth.effective_mass_kg = truth.penetration_m > kMoved_m
                                ? sup::effective_nail_mass_kg(truth.impulse_n_s, truth.contact_s, truth.penetration_m)
                                : std::numeric_limits<double>::infinity();
  truth.restitution = blow->speed_at_start_m_s > 0.0 ? -blow->speed_at_end_m_s / blow->speed_at_start_m_s : 0.0;
  for (std::size_t i = 0; i < dof; ++i) {
    truth.joints[i].peak_torque_nm = blow->peak_transmission_torque_nm[i];
    truth.joints[i].peak_torque_swing_nm =
        std::max(truth.joints[i].peak_torque_swing_nm, truth.joints[i].peak_torque_nm);
    truth.joints[i].impulse_nm_s = blow->transmission_impulse_nm_s[i];
    if (truth.joints[i].passive && was_passive_[i]) {
      truth.joints[i].switch_lead_s = (blow->start - passive_since_[i]).seconds();
    }
  }
  return truth;
}

}  // namespace mrr::sim
