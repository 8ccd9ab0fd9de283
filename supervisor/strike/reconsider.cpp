#include "supervisor/strike/reconsider.h"

#include <algorithm>
#include <bit>
#include <set>

namespace mrr::sup {
namespace {

/// Feasible before not, then the lighter; sets as numbers where nothing tells them apart.
bool lighter(const RankedSelection& a, const RankedSelection& b) noexcept {
  if (a.feasible != b.feasible) return a.feasible;
  if (a.feasible && a.peak_ratio_per_n_s != b.peak_ratio_per_n_s) return a.peak_ratio_per_n_s < b.peak_ratio_per_n_s;
  if (!a.feasible && a.peak_ratio != b.peak_ratio) return a.peak_ratio < b.peak_ratio;
  return a.passive < b.passive;
}

/// Visits sets, each once.
class Search {
 public:
  Search(const SelectionContest& contest, PredictionModel model) : contest_(contest), model_(model) {}

  void visit(std::uint32_t passive) {
    if (!seen_.insert(passive).second) return;
    const std::optional<PredictInput> input = contest_.blow(passive);
    if (input) found_.push_back(rank_selection(contest_, *input, model_));
  }

  /// Best first: all neighbours of the best set not yet left, until the `best` lightest have all been left.
  void spread(std::size_t best) {
    std::set<std::uint32_t> left;
    for (bool on = true; on;) {
      on = false;
      const std::size_t top = std::min(best, found_.size());
      std::partial_sort(found_.begin(), found_.begin() + static_cast<std::ptrdiff_t>(top), found_.end(), lighter);
      for (std::size_t k = 0; k < top && !on; ++k) {
        const std::uint32_t centre = found_[k].passive;
        if (!left.insert(centre).second) continue;
        on = true;
        for (std::uint32_t rest = contest_.candidates; rest != 0; rest &= rest - 1) {
          visit(centre ^ (rest & ~(rest - 1)));
        }
      }
    }
  }

  [[nodiscard]] std::vector<RankedSelection>& found() noexcept { return found_; }

 private:
  const SelectionContest& contest_;
  PredictionModel model_;
  std::set<std::uint32_t> seen_;
  std::vector<RankedSelection> found_;
};

}  // namespace

RankedSelection rank_selection(const SelectionContest& contest, const PredictInput& input, PredictionModel model) {
  RankedSelection out;
  out.model = model;
  const int n = contest.arm.chain.dof();
  for (int i = 0; i < n; ++i) {
    if (input.joints[static_cast<std::size_t>(i)] == JointHold::free) out.passive |= 1U << i;
  }
  const Prediction p = predict(contest.arm, input, model);
  out.impulse_n_s = p.impulse_n_s;
  out.switch_lead_s = input.switch_lead_s;
  out.passive_s = input.passive_s;
  out.feasible = p.feasible && p.approaching && p.impulse_n_s > 0.0;
  if (!out.feasible) return out;
  for (int i = 0; i < n; ++i) {
    const double peak = p.peak_torque_nm[i];
    const double ratio = peak / contest.rated_nm[static_cast<std::size_t>(i)];
    if (!(ratio <= out.peak_ratio)) {
      out.peak_ratio = ratio;
      out.heaviest = i;
      out.heaviest_nm = peak;
    }
    if (!(peak <= contest.repeated_nm[static_cast<std::size_t>(i)])) out.feasible = false;
  }
  out.peak_ratio_per_n_s = out.peak_ratio / out.impulse_n_s;
  return out;
}

std::vector<RankedSelection> rank_selections(const SelectionContest& contest, std::span<const std::uint32_t> starts) {
  const auto most = static_cast<std::size_t>(std::max(contest.resolved_at_most, 1));
  const int candidates = std::popcount(contest.candidates);
  const bool all = candidates <= contest.enumerated_at_most;
  const bool few = all && (std::size_t{1} << candidates) <= most;
  Search search(contest, few ? PredictionModel::resolved : PredictionModel::finite_time);
  std::vector<RankedSelection>& ranked = search.found();
  if (all) {
    // The subsets of a mask, all joints first.
    std::uint32_t passive = contest.candidates;
    while (true) {
      search.visit(passive);
      if (passive == 0) break;
      passive = (passive - 1) & contest.candidates;
    }
  } else {
    for (const std::uint32_t start : starts) search.visit(start & contest.candidates);
    search.visit(0);
    search.visit(contest.candidates);
    for (std::uint32_t rest = contest.candidates; rest != 0; rest &= rest - 1) {
      const std::uint32_t one = rest & ~(rest - 1);
      search.visit(one);
      search.visit(contest.candidates ^ one);
    }
    search.spread(3 * most);
  }
  std::sort(ranked.begin(), ranked.end(), lighter);
  const auto shortlist = ranked.begin() + static_cast<std::ptrdiff_t>(std::min(most, ranked.size()));
  for (auto s = ranked.begin(); !few && s != shortlist; ++s) {
    *s = rank_selection(contest, *contest.blow(s->passive), PredictionModel::resolved);
  }
  std::sort(ranked.begin(), shortlist, lighter);
  if (!ranked.empty() && ranked.front().feasible) {
    const double within = (1.0 + contest.tie) * ranked.front().peak_ratio_per_n_s;
    auto best = ranked.begin();
    for (auto s = ranked.begin(); s != shortlist && s->feasible && s->peak_ratio_per_n_s <= within; ++s) {
      if (std::popcount(s->passive) < std::popcount(best->passive)) best = s;
    }
    std::rotate(ranked.begin(), best, best + 1);
  }
  return ranked;
}

}  // namespace mrr::sup
