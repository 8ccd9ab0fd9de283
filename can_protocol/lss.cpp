#include "can_protocol/lss.h"

#include "can_protocol/codec.h"
#include "can_protocol/messages.h"

namespace mrr::can {
namespace {

// Command specifiers, CiA 305.
constexpr std::uint8_t kSwitchGlobal = 0x04;
constexpr std::uint8_t kConfigureNodeId = 0x11;
constexpr std::uint8_t kConfigureBitTiming = 0x13;
constexpr std::uint8_t kStore = 0x17;
constexpr std::uint8_t kSwitchSelective = 0x40;  // to 0x43: vendor, product, revision, serial
constexpr std::uint8_t kSelected = 0x44;
constexpr std::uint8_t kIdentify = 0x46;  // to 0x4B: vendor, product, lowest and highest revision, then serial
constexpr std::uint8_t kIdentifyUnconfigured = 0x4C;
constexpr std::uint8_t kIdentified = 0x4F;
constexpr std::uint8_t kIsUnconfigured = 0x50;
constexpr std::uint8_t kFastscan = 0x51;
constexpr std::uint8_t kInquire = 0x5A;  // to 0x5D: the four parts of the identity
constexpr std::uint8_t kInquireNodeId = 0x5E;

constexpr std::uint8_t kDone = 0;
constexpr std::uint8_t kNodeIdOutOfRange = 1;
constexpr std::uint8_t kBitRateNotSupported = 1;

// Table 0 of bit timings, bit/s.
constexpr std::array<std::uint32_t, 9> kBitRates{1'000'000, 800'000, 500'000, 250'000, 125'000,
                                                 0,         50'000,  20'000,  10'000};

Frame answer(std::uint8_t command) noexcept {
  Frame f;
  f.id = kLssAnswerCobId;
  f.length = 8;
  f.data[0] = command;
  return f;
}

Frame answer(std::uint8_t command, std::uint8_t value) noexcept {
  Frame f = answer(command);
  f.data[1] = value;
  return f;
}

}  // namespace

void LssSlave::reset(std::uint8_t active) noexcept {
  active_ = active;
  mode_ = Mode::waiting;
  selected_ = identified_ = scanned_ = 0;
}

std::optional<Frame> LssSlave::handle(const Frame& f, const LssIdentity& identity, LssStore& store) noexcept {
  if (f.length != 8) return std::nullopt;
  const std::uint8_t command = f.data[0];
  const auto number = get<std::uint32_t>(f.data.data() + 1);

  // The parts of a selection must come in their order; anything between them starts it anew.
  const std::uint8_t selected = selected_;
  const std::uint8_t identified = identified_;
  selected_ = identified_ = 0;

  if (command == kSwitchGlobal) {
    if (f.data[1] <= 1) mode_ = f.data[1] == 1 ? Mode::configuration : Mode::waiting;
    return std::nullopt;
  }
  if (command >= kIdentify && command < kIdentify + 6) {
    constexpr std::array<std::uint8_t, 6> kPart{0, 1, 2, 2, 3, 3};
    const auto step = static_cast<std::uint8_t>(command - kIdentify);
    if (step != 0 && step != identified) return std::nullopt;
    const std::uint32_t own = identity[kPart[step]];
    const bool lowest = step == 2 || step == 4;
    const bool highest = step == 3 || step == 5;
    const bool matches = lowest ? own >= number : highest ? own <= number : own == number;
    if (matches) identified_ = static_cast<std::uint8_t>(step + 1);
    if (identified_ < 6) return std::nullopt;
    identified_ = 0;
    return answer(kIdentified);
  }
  if (command == kIdentifyUnconfigured) {
    if (active_ != kUnconfiguredNodeId || node_id_ != kUnconfiguredNodeId) return std::nullopt;
    return answer(kIsUnconfigured);
  }

  if (mode_ == Mode::waiting) {
    if (command >= kSwitchSelective && command < kSwitchSelective + 4) {
      const auto part = static_cast<std::uint8_t>(command - kSwitchSelective);
      if ((part == 0 || part == selected) && identity[part] == number) selected_ = static_cast<std::uint8_t>(part + 1);
      if (selected_ < 4) return std::nullopt;
      selected_ = 0;
      mode_ = Mode::configuration;
      return answer(kSelected);
    }
    if (command == kFastscan && fastscan(f, identity)) return answer(kIdentified);
    return std::nullopt;
  }

  if (command == kConfigureNodeId) {
    const std::uint8_t id = f.data[1];
    if (!((id >= 1 && id <= kMaxNodeId) || id == kUnconfiguredNodeId)) return answer(command, kNodeIdOutOfRange);
    node_id_ = id;
    return answer(command, kDone);
  }
  if (command == kConfigureBitTiming) {
    // The rate is the shell's affair: only the one that is in force can be had.
    const bool same = f.data[1] == 0 && f.data[2] < kBitRates.size() && kBitRates[f.data[2]] == bit_rate_;
    return answer(command, same ? kDone : kBitRateNotSupported);
  }
  if (command == kStore) return answer(command, static_cast<std::uint8_t>(store.store_node_id(node_id_)));
  if (command >= kInquire && command < kInquire + 4) {
    Frame reply = answer(command);
    put<std::uint32_t>(reply.data.data() + 1, identity[static_cast<std::size_t>(command - kInquire)]);
    return reply;
  }
  if (command == kInquireNodeId) return answer(command, active_);
  return std::nullopt;
}

bool LssSlave::fastscan(const Frame& f, const LssIdentity& identity) noexcept {
  if (active_ != kUnconfiguredNodeId || node_id_ != kUnconfiguredNodeId) return false;
  const auto number = get<std::uint32_t>(f.data.data() + 1);
  const std::uint8_t bit = f.data[5];
  const std::uint8_t part = f.data[6];
  const std::uint8_t next = f.data[7];
  if (bit == 0x80) {  // is anybody there?
    scanned_ = 0;
    return true;
  }
  if (bit > 31 || part > 3 || next > 3 || part != scanned_) return false;
  if (((number ^ identity[part]) >> bit) != 0) return false;
  if (bit == 0) {
    // The whole part is confirmed. Going back to an earlier one ends the scan: this module is found.
    if (next < part) mode_ = Mode::configuration;
    scanned_ = next;
  }
  return true;
}

}  // namespace mrr::can
