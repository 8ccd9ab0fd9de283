#include "can_protocol/node.h"

namespace mrr::can {
namespace {

constexpr std::uint32_t kNotValid = 1U << 31U;        // COB-ID entries of PDOs and EMCY
constexpr std::uint32_t kNoRemote = 1U << 30U;        // TPDO; in 1005h the same bit means "produces SYNC"
constexpr std::uint32_t kNotElevenBit = 0x3FFFF800U;  // bits that an 11-bit COB-ID leaves 0 (29-bit flag included)
constexpr std::uint32_t kElevenBit = 0x7FFU;
constexpr std::uint8_t kLastSynchronousType = 240;
constexpr std::uint8_t kTimerOnlyType = 254;
constexpr std::uint32_t kSaveSignature = 0x65766173;
constexpr std::uint32_t kLoadSignature = 0x64616F6C;

/// CAN-IDs that CiA 301 keeps for itself (table "restricted CAN-IDs").
constexpr bool is_restricted(std::uint32_t id) noexcept {
  return id <= 0x07F || (id >= 0x101 && id <= 0x180) || (id >= 0x581 && id <= 0x5FF) || (id >= 0x601 && id <= 0x67F) ||
         (id >= 0x6E0 && id <= 0x6FF) || id >= 0x701;
}

constexpr bool is_valid(std::uint32_t cob_id) noexcept { return (cob_id & kNotValid) == 0; }
constexpr bool is_synchronous(std::uint8_t type) noexcept { return type <= kLastSynchronousType; }

/// Bits of the error register (1001h) that an emergency code stands for; bit 0 is added for any.
constexpr std::uint8_t register_bits(Emergency code) noexcept {
  const auto c = static_cast<unsigned>(code);
  switch (c >> 12U) {
    case 0x2:
      return 1U << 1U;
    case 0x3:
      return 1U << 2U;
    case 0x4:
      return 1U << 3U;
    case 0x8:
      return (c & 0xFF00U) <= 0x8200U ? 1U << 4U : 1U << 5U;
    case 0xF:
      return 1U << 7U;
    default:
      return 0;
  }
}

/// Copies the entries from `low` to `high` that have one of `flags`. What answers to a command (1010h, 1011h) and the
/// error history are no parameters and stay.
void copy_range(const ObjectDictionary& from, ObjectDictionary& to, std::uint16_t low, std::uint16_t high,
                std::uint8_t flags) noexcept {
  for (const Entry& e : kEntries) {
    if (e.index < low || e.index > high || !(e.flags & flags)) continue;
    if (e.index == 0x1003 || e.index == 0x1010 || e.index == 0x1011) continue;
    std::memcpy(reinterpret_cast<unsigned char*>(&to) + e.offset,
                reinterpret_cast<const unsigned char*>(&from) + e.offset, e.size);
  }
}

/// A mapped object's bytes; the sizes that objects have are one instruction each.
inline void copy_bytes(unsigned char* to, const unsigned char* from, std::size_t size) noexcept {
  switch (size) {
    case 1:
      *to = *from;
      return;
    case 2:
      std::memcpy(to, from, 2);
      return;
    case 4:
      std::memcpy(to, from, 4);
      return;
    default:
      std::memcpy(to, from, size);
      return;
  }
}

/// Consumer heartbeat time (1016h): node id and timeout.
constexpr std::uint8_t watched_node(std::uint32_t v) noexcept { return static_cast<std::uint8_t>(v >> 16U); }
constexpr Duration watched_timeout(std::uint32_t v) noexcept { return milliseconds(v & 0xFFFFU); }

}  // namespace

Node::Node(ObjectDictionary& od, const NodeConfig& config, NodeApplication& application) noexcept
    : od_(od), config_(config), application_(application), lss_(config.node_id, config.bit_rate) {
  for (const Entry& e : kEntries) {
    if (!(e.flags & kAddsNodeId)) continue;
    Value v = read_value(od_, e);
    put<std::uint32_t>(v.bytes.data(), static_cast<std::uint32_t>(v.as_unsigned()) + config_.node_id);
    write_value(od_, e, v);
  }
  factory_ = od_;
  power_on_ = od_;
  lss_.reset(config_.node_id);
}

void Node::change_node_id(std::uint8_t to) noexcept {
  static constexpr ObjectDictionary kDefaults{};
  for (const Entry& e : kEntries) {
    if (!(e.flags & kAddsNodeId)) continue;
    const auto base = static_cast<std::uint32_t>(read_value(kDefaults, e).as_unsigned());
    for (ObjectDictionary* od : {&od_, &factory_, &power_on_}) {
      Value v = read_value(*od, e);
      if (v.as_unsigned() != base + config_.node_id) continue;
      put<std::uint32_t>(v.bytes.data(), base + to);
      write_value(*od, e, v);
    }
  }
  config_.node_id = to;
  sort_pdos();
}

void Node::begin_with(std::uint8_t node_id) noexcept {
  change_node_id(node_id);
  lss_.begin_with(node_id);
}

// ---- frames in ----

void Node::handle(const ReceivedFrame& received, TransmitQueue& tx) noexcept {
  if (!started_) return;
  wake();
  const Frame& f = received.frame;
  const Time now = received.at;
  if (f.extended || f.remote || f.fd || f.length > 8 || f.id > kElevenBit) return reject();

  if (f.id == kLssRequestCobId) return handle_lss(f, now, tx);
  if (f.id == kLssAnswerCobId || is_unconfigured()) return;
  const bool communicates = state_ == NmtState::pre_operational || state_ == NmtState::operational;
  if (f.id == kNmtCobId) return handle_nmt(f, now, tx);
  if (f.id == (od_.sync_cob_id & kElevenBit)) {
    if (communicates) handle_sync(f, now, tx);
    return;
  }
  if (f.id == kSdoRequestCobId + config_.node_id) {
    if (communicates) return handle_sdo(f, now, tx);
    return reject();
  }
  if (f.id > kHeartbeatCobId) return handle_heartbeat(f, now);
  for (std::size_t i = 0; i < kRpdoCount; ++i) {
    if (f.id == rpdo_id_[i]) handle_rpdo(i, f, now);
  }
}

void Node::handle_lss(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (f.length != 8) return reject();
  if (state_ == NmtState::operational) return;  // nobody is renamed while it moves
  const LssIdentity identity{od_.identity_vendor_id, od_.identity_product_code, od_.identity_revision,
                             od_.identity_serial_number};
  if (const auto answer = lss_.handle(f, identity, application_)) send(*answer, tx);
  // A node that had no id comes up with its first one as soon as it is let go.
  if (is_unconfigured() && lss_.node_id() != kUnconfiguredNodeId && lss_.mode() == LssSlave::Mode::waiting) {
    reset(ResetKind::communication, now, tx);
  }
}

void Node::handle_nmt(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (f.length != 2) return reject();
  if (f.data[1] != 0 && f.data[1] != config_.node_id) return;
  switch (static_cast<NmtCommand>(f.data[0])) {
    case NmtCommand::start:
      return enter(NmtState::operational, now);
    case NmtCommand::stop:
      return enter(NmtState::stopped, now);
    case NmtCommand::enter_pre_operational:
      return enter(NmtState::pre_operational, now);
    case NmtCommand::reset_node:
      return reset(ResetKind::node, now, tx);
    case NmtCommand::reset_communication:
      return reset(ResetKind::communication, now, tx);
  }
  reject();
}

void Node::handle_sync(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  const bool counted = od_.sync_counter_overflow != 0;
  if (f.length != (counted ? 1 : 0)) {
    raise(Emergency::sync_length, {f.length}, now);
    return reject();
  }
  std::optional<std::uint8_t> counter;
  if (counted) {
    if (!(f.data[0] >= 1 && f.data[0] <= od_.sync_counter_overflow)) return reject();
    counter = f.data[0];
  }
  if (!errors_.empty()) clear(Emergency::sync_length, now);
  ++od_.count_sync;
  if (state_ == NmtState::operational) {
    for (std::uint32_t left = pending_rpdos_; left != 0; left &= left - 1U) {
      deliver(static_cast<std::size_t>(std::countr_zero(left)), now);
    }
    pending_rpdos_ = 0;
  }
  application_.sync(now, counter);
  if (state_ != NmtState::operational) return;
  for (std::uint32_t left = synchronous_tpdos_; left != 0; left &= left - 1U) {
    const auto i = static_cast<std::size_t>(std::countr_zero(left));
    const PdoCommunication& pdo = od_.tpdo_communication[i];
    Tpdo& t = tpdo_[i];
    if (t.waits_for_start && counter) {
      if (*counter != pdo.sync_start_value) continue;
    }
    t.waits_for_start = false;  // this SYNC counts as the first
    if (pdo.transmission_type == 0) {
      std::array<std::uint8_t, kMaxPdoBytes> data{};
      const bool changed = pack(i, data) != 0 && (!t.has_sent || data != t.last);
      if (t.requested || changed) send_tpdo(i, now, tx);
    } else if (++t.syncs >= pdo.transmission_type) {
      send_tpdo(i, now, tx);
    }
  }
}

void Node::handle_heartbeat(const Frame& f, Time now) noexcept {
  const auto heartbeat = parse_heartbeat(f);
  if (!heartbeat) return reject();
  for (std::size_t i = 0; i < kMaxWatched; ++i) {
    const std::uint32_t setting = od_.consumer_heartbeat[i];
    Watched& w = watched_[i];
    if (watched_timeout(setting).ns == 0 || watched_node(setting) != heartbeat->node_id) continue;
    const bool is_boot_up = heartbeat->state == NmtState::initialising;
    if (is_boot_up && !w.running) continue;  // watching starts with the first heartbeat proper
    w.running = watches_ = true;
    w.last = now;
    w.lost = false;
    bool any_lost = false;
    for (const Watched& other : watched_) any_lost = any_lost || other.lost;
    if (!any_lost) clear(Emergency::heartbeat_lost, now);
    application_.heartbeat_seen(heartbeat->node_id, heartbeat->state, now);
  }
}

// ---- RPDO ----

void Node::handle_rpdo(std::size_t i, const Frame& f, Time now) noexcept {
  if (state_ != NmtState::operational) return reject();
  const Layout& layout = rpdo_layout_[i];
  Rpdo& r = rpdo_[i];

  // The whole PDO is judged before any of it has an effect.
  const std::size_t total = layout.bytes;
  if (layout.objects.empty()) return reject();
  if (f.length < total) {
    ++od_.count_rejected_pdos;
    r.too_short = true;
    raise(Emergency::pdo_length, {static_cast<std::uint8_t>(i + 1), f.length, static_cast<std::uint8_t>(total)}, now);
    return reject();
  }
  if (layout.checked) {
    std::size_t at = 0;
    for (const Mapped& m : layout.objects) {
      if (m.checked) {
        Value v;
        v.size = m.size;
        std::memcpy(v.bytes.data(), f.data.data() + at, m.size);
        if (check_value(*m.entry, v) != Abort::none) {
          ++od_.count_rejected_pdos;
          return reject();
        }
      }
      at += m.size;
    }
  }

  std::memcpy(r.data.data(), f.data.data(), kMaxPdoBytes);
  r.received = now;
  r.watched = true;
  r.too_short = false;
  r.late = false;
  if (!errors_.empty()) {
    bool any_short = false;
    bool any_late = false;
    for (const Rpdo& other : rpdo_) {
      any_short = any_short || other.too_short;
      any_late = any_late || other.late;
    }
    if (!any_short) clear(Emergency::pdo_length, now);
    if (!any_late) clear(Emergency::rpdo_timeout, now);
  }

  if (is_synchronous(od_.rpdo_communication[i].transmission_type)) {
    pending_rpdos_ |= 1U << i;
  } else {
    deliver(i, now);
  }
}

void Node::deliver(std::size_t i, Time now) noexcept {
  const Rpdo& r = rpdo_[i];
  const Layout& layout = rpdo_layout_[i];
  auto* const objects = reinterpret_cast<unsigned char*>(&od_);
  std::size_t at = 0;
  for (const Mapped& m : layout.objects) {
    if (m.entry) copy_bytes(objects + m.offset, r.data.data() + at, m.size);
    at += m.size;
  }
  if (layout.followed) {
    for (const Mapped& m : layout.objects) {
      if (m.followed) after_write(id_of(*m.entry), WriteSource::rpdo, now);
    }
  }
  application_.pdo_delivered(static_cast<std::uint8_t>(i + 1), r.received);
}

void Node::after_write(ObjectId id, WriteSource source, Time now) noexcept {
  application_.written(id, source, now);
  if (id != ObjectId::selection_command) return;
  const auto command =
      selection_from({od_.selection_mask, od_.selection_sync_counter, od_.selection_offset_us, od_.selection_command});
  if (command) application_.selection(*command, now);
}

// ---- SDO server ----

void Node::handle_sdo(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (f.length != 8) return reject();
  switch (f.data[0] >> 5U) {
    case 0:
      return sdo_download_segment(f, now, tx);
    case 1:
      return sdo_download(f, now, tx);
    case 2:
      return sdo_upload(f, now, tx);
    case 3:
      return sdo_upload_segment(f, now, tx);
    case 4:
      if (sdo_.transfer != Transfer::none) ++od_.count_sdo_aborts;
      sdo_.transfer = Transfer::none;
      return;
    default:
      break;  // block transfer is not offered
  }
  sdo_abort(get<std::uint16_t>(f.data.data() + 1), f.data[3], Abort::unknown_command, tx);
}

void Node::sdo_download(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  const auto index = get<std::uint16_t>(f.data.data() + 1);
  const std::uint8_t sub = f.data[3];
  const bool expedited = f.data[0] & 2U;
  const bool has_size = f.data[0] & 1U;
  sdo_.transfer = Transfer::none;

  const Entry* entry = nullptr;
  if (const Abort a = find(index, sub, entry); a != Abort::none) return sdo_abort(index, sub, a, tx);
  if (!(entry->flags & kWritable)) return sdo_abort(index, sub, Abort::read_only, tx);

  const std::array<std::uint8_t, 8> reply{0x60, f.data[1], f.data[2], f.data[3]};
  if (expedited) {
    Value v;
    v.size = static_cast<std::uint8_t>(has_size ? 4U - ((f.data[0] >> 2U) & 3U) : std::min<unsigned>(4, entry->size));
    std::memcpy(v.bytes.data(), f.data.data() + 4, v.size);
    const Abort a = write(*entry, v, now);
    return a == Abort::none ? sdo_reply(reply, tx) : sdo_abort(index, sub, a, tx);
  }

  const auto announced = get<std::uint32_t>(f.data.data() + 4);
  if (has_size) {
    if (announced > entry->size) return sdo_abort(index, sub, Abort::too_long, tx);
    if (announced < entry->size && entry->type != Type::string) return sdo_abort(index, sub, Abort::too_short, tx);
  }
  sdo_ = {};
  sdo_.transfer = Transfer::download;
  sdo_.entry = entry;
  sdo_.announced = announced;
  sdo_.has_announced = has_size;
  sdo_.last = now;
  sdo_reply(reply, tx);
}

void Node::sdo_download_segment(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (sdo_.transfer != Transfer::download) return sdo_abort(0, 0, Abort::unknown_command, tx);
  const Entry& entry = *sdo_.entry;
  const bool toggle = f.data[0] & 0x10U;
  const bool last = f.data[0] & 1U;
  const std::size_t size = 7U - ((f.data[0] >> 1U) & 7U);
  if (toggle != sdo_.toggle) return sdo_abort(entry.index, entry.sub, Abort::toggle, tx);
  if (sdo_.at + size > entry.size) return sdo_abort(entry.index, entry.sub, Abort::too_long, tx);
  std::memcpy(sdo_.value.bytes.data() + sdo_.at, f.data.data() + 1, size);
  sdo_.at += size;
  sdo_.toggle = !sdo_.toggle;
  sdo_.last = now;
  if (sdo_.has_announced && (sdo_.at > sdo_.announced || (last && sdo_.at < sdo_.announced))) {
    return sdo_abort(entry.index, entry.sub, Abort::length, tx);
  }
  if (last) {
    sdo_.value.size = static_cast<std::uint8_t>(sdo_.at);
    const Abort a = write(entry, sdo_.value, now);
    if (a != Abort::none) return sdo_abort(entry.index, entry.sub, a, tx);
    sdo_.transfer = Transfer::none;
  }
  sdo_reply({static_cast<std::uint8_t>(0x20U | (toggle ? 0x10U : 0U))}, tx);
}

void Node::sdo_upload(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  const auto index = get<std::uint16_t>(f.data.data() + 1);
  const std::uint8_t sub = f.data[3];
  sdo_.transfer = Transfer::none;

  const Entry* entry = nullptr;
  if (const Abort a = find(index, sub, entry); a != Abort::none) return sdo_abort(index, sub, a, tx);
  if (!(entry->flags & kReadable)) return sdo_abort(index, sub, Abort::write_only, tx);
  if (index == 0x1003 && sub > od_.error_history_count) return sdo_abort(index, sub, Abort::no_data, tx);

  const Value v = read_value(od_, *entry);
  std::array<std::uint8_t, 8> reply{0, f.data[1], f.data[2], f.data[3]};
  if (v.size >= 1 && v.size <= 4) {
    reply[0] = static_cast<std::uint8_t>(0x43U | ((4U - v.size) << 2U));
    std::memcpy(reply.data() + 4, v.bytes.data(), v.size);
    return sdo_reply(reply, tx);
  }
  sdo_ = {};
  sdo_.transfer = Transfer::upload;
  sdo_.entry = entry;
  sdo_.value = v;  // a picture of this instant: later changes do not mix in
  sdo_.last = now;
  reply[0] = 0x41;
  put<std::uint32_t>(reply.data() + 4, v.size);
  sdo_reply(reply, tx);
}

void Node::sdo_upload_segment(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (sdo_.transfer != Transfer::upload) return sdo_abort(0, 0, Abort::unknown_command, tx);
  const bool toggle = f.data[0] & 0x10U;
  if (toggle != sdo_.toggle) return sdo_abort(sdo_.entry->index, sdo_.entry->sub, Abort::toggle, tx);
  const std::size_t size = std::min<std::size_t>(7, sdo_.value.size - sdo_.at);
  const bool last = sdo_.at + size == sdo_.value.size;
  std::array<std::uint8_t, 8> reply{};
  reply[0] = static_cast<std::uint8_t>((toggle ? 0x10U : 0U) | ((7U - size) << 1U) | (last ? 1U : 0U));
  std::memcpy(reply.data() + 1, sdo_.value.bytes.data() + sdo_.at, size);
  sdo_.at += size;
  sdo_.toggle = !sdo_.toggle;
  sdo_.last = now;
  if (last) sdo_.transfer = Transfer::none;
  sdo_reply(reply, tx);
}

void Node::sdo_abort(std::uint16_t index, std::uint8_t sub, Abort code, TransmitQueue& tx) noexcept {
  sdo_.transfer = Transfer::none;
  ++od_.count_sdo_aborts;
  std::array<std::uint8_t, 8> reply{0x80};
  put<std::uint16_t>(reply.data() + 1, index);
  reply[3] = sub;
  put<std::uint32_t>(reply.data() + 4, static_cast<std::uint32_t>(code));
  sdo_reply(reply, tx);
}

void Node::sdo_reply(const std::array<std::uint8_t, 8>& data, TransmitQueue& tx) noexcept {
  Frame f;
  f.id = kSdoReplyCobId + config_.node_id;
  f.length = 8;
  std::copy(data.begin(), data.end(), f.data.begin());
  send(f, tx);
}

// ---- writing by SDO ----

Abort Node::find(std::uint16_t index, std::uint8_t sub, const Entry*& out) const noexcept {
  const bool hidden = !config_.test_objects;
  out = find_entry(index, sub);
  if (out && !(hidden && (out->flags & kTestOnly))) return Abort::none;
  // Whoever hides sub-index 0 hides the object.
  const Entry* first = find_entry(index, 0);
  if (first && hidden && (first->flags & kTestOnly)) return Abort::no_object;
  return has_index(index) ? Abort::no_sub_index : Abort::no_object;
}

Abort Node::write(const Entry& entry, const Value& value, Time now) noexcept {
  if (const Abort a = check_value(entry, value); a != Abort::none) return a;

  const ObjectId id = id_of(entry);
  if (id == ObjectId::store_all) {
    if (value.as_unsigned() != kSaveSignature) return Abort::cannot_store;
    const Abort a = application_.store(now);
    if (a == Abort::none) copy_range(od_, power_on_, 0x1000, 0xFFFF, kStored);
    return a;
  }
  if (id == ObjectId::restore_all) {
    if (value.as_unsigned() != kLoadSignature) return Abort::cannot_store;
    const Abort a = application_.restore_defaults(now);
    if (a == Abort::none) copy_range(factory_, power_on_, 0x1000, 0xFFFF, kStored);
    return a;
  }

  if (entry.index < 0x2000) {
    if (const Abort a = check_communication(entry, value); a != Abort::none) return a;
  }
  if (const Abort a = application_.may_write(id, value); a != Abort::none) return a;
  write_value(od_, entry, value);
  if (entry.index < 0x2000) communication_written(entry, now);
  after_write(id, WriteSource::sdo, now);
  return Abort::none;
}

Abort Node::check_communication(const Entry& entry, const Value& value) const noexcept {
  const auto v = static_cast<std::uint32_t>(value.as_unsigned());
  const std::size_t i = entry.index & 0xFU;
  switch (entry.index & 0xFF00U) {
    case 0x1400:
      return check_pdo_communication(od_.rpdo_communication[i], true, entry.sub, value);
    case 0x1600:
      return check_pdo_mapping(od_.rpdo_mapping[i], od_.rpdo_communication[i], true, entry.sub, value);
    case 0x1800:
      return check_pdo_communication(od_.tpdo_communication[i], false, entry.sub, value);
    case 0x1A00:
      return check_pdo_mapping(od_.tpdo_mapping[i], od_.tpdo_communication[i], false, entry.sub, value);
    default:
      break;
  }
  switch (entry.index) {
    case 0x1003:
      return v == 0 ? Abort::none : Abort::value;
    case 0x1005:
      return (v & (kNotElevenBit | kNoRemote)) || is_restricted(v & kElevenBit) ? Abort::value : Abort::none;
    case 0x1014:
      if ((v & (kNotElevenBit | kNoRemote)) || is_restricted(v & kElevenBit)) return Abort::value;
      return is_valid(v) && is_valid(od_.emergency_cob_id) && v != od_.emergency_cob_id ? Abort::value : Abort::none;
    case 0x1016:
      if (v >> 24U) return Abort::value;
      if (watched_timeout(v).ns == 0 || !(watched_node(v) >= 1 && watched_node(v) <= kMaxNodeId)) return Abort::none;
      for (std::size_t k = 0; k < kMaxWatched; ++k) {
        const std::uint32_t other = od_.consumer_heartbeat[k];
        if (k + 1 != entry.sub && watched_timeout(other).ns != 0 && watched_node(other) == watched_node(v)) {
          return Abort::incompatible_parameter;
        }
      }
      return Abort::none;
    case 0x1019:
      if (v == 1) return Abort::value;
      return v != od_.sync_counter_overflow && od_.communication_cycle_period_us != 0 ? Abort::state : Abort::none;
    default:
      return Abort::none;
  }
}

Abort Node::check_pdo_communication(const PdoCommunication& pdo, bool receive, std::uint8_t sub,
                                    const Value& value) const noexcept {
  const auto v = static_cast<std::uint32_t>(value.as_unsigned());
  const bool valid = is_valid(pdo.cob_id);
  switch (sub) {
    case 1:
      if (v & kNotElevenBit & ~kNoRemote) return Abort::value;
      if (!is_valid(v)) return Abort::none;
      if (!receive && !(v & kNoRemote)) return Abort::value;  // remote requests are not answered
      if (is_restricted(v & kElevenBit)) return Abort::value;
      return valid && (v & kElevenBit) != (pdo.cob_id & kElevenBit) ? Abort::value : Abort::none;
    case 2:
      return v > kLastSynchronousType && v < kTimerOnlyType ? Abort::value : Abort::none;
    case 3:
      return valid && v != pdo.inhibit_time_100us ? Abort::state : Abort::none;
    case 6:
      return valid && v != pdo.sync_start_value ? Abort::state : Abort::none;
    default:
      return Abort::none;
  }
}

Abort Node::check_pdo_mapping(const PdoMapping& map, const PdoCommunication& pdo, bool receive, std::uint8_t sub,
                              const Value& value) const noexcept {
  if (is_valid(pdo.cob_id)) return Abort::state;
  const auto v = static_cast<std::uint32_t>(value.as_unsigned());
  Mapped m{};
  if (sub != 0) {
    if (map.count != 0) return Abort::state;
    return v == 0 ? Abort::none : find_mapped(v, receive, m);
  }
  std::size_t total = 0;
  for (std::size_t k = 0; k < v; ++k) {
    if (const Abort a = find_mapped(map.entries[k], receive, m); a != Abort::none) return a;
    total += m.size;
  }
  return total > kMaxPdoBytes ? Abort::mapping_length : Abort::none;
}

Abort Node::find_mapped(std::uint32_t mapping, bool receive, Mapped& out) const noexcept {
  const auto index = static_cast<std::uint16_t>(mapping >> 16U);
  const auto sub = static_cast<std::uint8_t>(mapping >> 8U);
  const auto bits = static_cast<std::uint8_t>(mapping);
  if (receive && sub == 0 && index >= 0x0002 && index <= 0x0007) {
    constexpr std::array<std::uint8_t, 6> kDummyBits{8, 16, 32, 8, 16, 32};
    if (bits != kDummyBits[index - 2U]) return Abort::not_mappable;
    out = {nullptr, static_cast<std::uint8_t>(bits / 8U)};
    return Abort::none;
  }
  const Entry* entry = nullptr;
  if (const Abort a = find(index, sub, entry); a != Abort::none) return a;
  if (!(entry->flags & (receive ? kRpdoMappable : kTpdoMappable))) return Abort::not_mappable;
  if (bits != 8U * entry->size) return Abort::not_mappable;
  out = {entry, static_cast<std::uint8_t>(entry->size), entry->offset};
  return Abort::none;
}

Node::Layout Node::layout_of(const PdoMapping& map, bool receive) const noexcept {
  Layout layout;
  for (std::size_t k = 0; k < map.count; ++k) {
    Mapped m{};
    if (k >= kMaxMappedObjects || find_mapped(map.entries[k], receive, m) != Abort::none) return {};
    if (receive && m.entry) {
      m.checked = m.entry->limits != kNoLimits || m.entry->type == Type::f32;
      const ObjectId id = id_of(*m.entry);
      m.followed = id == ObjectId::selection_command || application_.follows(id);
      layout.checked = layout.checked || m.checked;
      layout.followed = layout.followed || m.followed;
    }
    (void)layout.objects.push_back(m);
    layout.bytes += m.size;
  }
  return layout.bytes <= kMaxPdoBytes ? layout : Layout{};
}

void Node::lay_out_pdos() noexcept {
  for (std::size_t i = 0; i < kRpdoCount; ++i) rpdo_layout_[i] = layout_of(od_.rpdo_mapping[i], true);
  for (std::size_t i = 0; i < kTpdoCount; ++i) tpdo_layout_[i] = layout_of(od_.tpdo_mapping[i], false);
  sort_pdos();
}

void Node::sort_pdos() noexcept {
  timed_rpdos_ = timed_tpdos_ = synchronous_tpdos_ = 0;
  for (std::size_t i = 0; i < kRpdoCount; ++i) {
    const PdoCommunication& pdo = od_.rpdo_communication[i];
    rpdo_id_[i] = is_valid(pdo.cob_id) ? pdo.cob_id & kElevenBit : kNoId;
    if (is_valid(pdo.cob_id) && pdo.event_timer_ms != 0) timed_rpdos_ |= 1U << i;
  }
  for (std::size_t i = 0; i < kTpdoCount; ++i) {
    const PdoCommunication& pdo = od_.tpdo_communication[i];
    if (!is_valid(pdo.cob_id)) continue;
    (is_synchronous(pdo.transmission_type) ? synchronous_tpdos_ : timed_tpdos_) |= 1U << i;
  }
}

void Node::communication_written(const Entry& entry, Time now) noexcept {
  const std::size_t i = entry.index & 0xFU;
  switch (entry.index & 0xFF00U) {
    case 0x1600:
      rpdo_layout_[i] = layout_of(od_.rpdo_mapping[i], true);
      [[fallthrough]];
    case 0x1400:
      rpdo_[i] = {};
      pending_rpdos_ &= ~(1U << i);
      return sort_pdos();
    case 0x1A00:
      tpdo_layout_[i] = layout_of(od_.tpdo_mapping[i], false);
      [[fallthrough]];
    case 0x1800:
      restart_tpdo(i);
      return sort_pdos();
    default:
      break;
  }
  switch (entry.index) {
    case 0x1003:
      od_.error_history = {};
      return;
    case 0x1016:
      watched_[entry.sub - 1U] = {};
      return;
    case 0x1017:
      next_heartbeat_ = now;
      return;
    default:
      return;
  }
}

// ---- TPDO ----

void Node::restart_tpdo(std::size_t i) noexcept {
  tpdo_[i] = {};
  tpdo_[i].requested = !is_synchronous(od_.tpdo_communication[i].transmission_type);
  tpdo_[i].waits_for_start = od_.tpdo_communication[i].sync_start_value != 0;
}

std::size_t Node::pack(std::size_t i, std::array<std::uint8_t, kMaxPdoBytes>& data) const noexcept {
  const auto* const objects = reinterpret_cast<const unsigned char*>(&od_);
  std::size_t at = 0;
  for (const Mapped& m : tpdo_layout_[i].objects) {
    copy_bytes(data.data() + at, objects + m.offset, m.size);
    at += m.size;
  }
  return at;
}

void Node::send_tpdo(std::size_t i, Time now, TransmitQueue& tx) noexcept {
  Tpdo& t = tpdo_[i];
  Frame f;
  std::array<std::uint8_t, kMaxPdoBytes> data{};
  f.length = static_cast<std::uint8_t>(pack(i, data));
  t.syncs = 0;
  t.requested = false;
  t.sent = now;
  t.has_sent = true;
  t.last = data;
  if (f.length == 0) return;
  f.id = od_.tpdo_communication[i].cob_id & kElevenBit;
  std::copy(data.begin(), data.end(), f.data.begin());
  send(f, tx);
}

void Node::tick_tpdo(std::size_t i, Time now, TransmitQueue& tx) noexcept {
  const PdoCommunication& pdo = od_.tpdo_communication[i];
  Tpdo& t = tpdo_[i];
  bool due = t.requested;
  if (pdo.event_timer_ms != 0 && now - t.sent >= milliseconds(pdo.event_timer_ms)) due = true;
  if (due || pdo.transmission_type != kTimerOnlyType) application_.refresh();
  if (!due && pdo.transmission_type != kTimerOnlyType) {
    std::array<std::uint8_t, kMaxPdoBytes> data{};
    due = pack(i, data) != 0 && data != t.last;
  }
  const Duration inhibit = microseconds(100) * pdo.inhibit_time_100us;
  if (due && (!t.has_sent || now - t.sent >= inhibit)) send_tpdo(i, now, tx);
}

void Node::request_tpdo(std::uint8_t number) noexcept {
  if (number >= 1 && number <= kTpdoCount) tpdo_[number - 1U].requested = true;
  wake();
}

// ---- states and timers ----

void Node::boot_up(Time now, TransmitQueue& tx) noexcept {
  if (is_unconfigured()) return;  // says nothing, and stays in initialising
  send(heartbeat_frame(config_.node_id, NmtState::initialising), tx);
  next_heartbeat_ = now + milliseconds(od_.producer_heartbeat_ms);
  enter(NmtState::pre_operational, now);
}

void Node::enter(NmtState state, Time now) noexcept {
  if (state == state_) return;
  state_ = state;
  // Nothing that waited in another state may have an effect in this one.
  if (state != NmtState::pre_operational && state != NmtState::operational) sdo_ = {};
  pending_rpdos_ = 0;
  for (Rpdo& r : rpdo_) r.watched = false;
  if (state == NmtState::operational) {
    for (std::size_t i = 0; i < kTpdoCount; ++i) restart_tpdo(i);
  }
  application_.nmt_changed(state, now);
}

void Node::reset(ResetKind kind, Time now, TransmitQueue& tx) noexcept {
  enter(NmtState::initialising, now);
  sdo_ = {};
  rpdo_ = {};
  pending_rpdos_ = 0;
  watched_ = {};
  copy_range(power_on_, od_, 0x1000, kind == ResetKind::node ? 0xFFFF : 0x1FFF, kWritable);
  lay_out_pdos();
  if (kind == ResetKind::node) {
    errors_.clear();
    od_.error_history = {};
    od_.error_history_count = 0;
  } else {
    // The communication starts anew; what is wrong with the joint stays wrong.
    std::size_t kept = 0;
    for (const Error& e : errors_) {
      if (e.register_bits != 1U << 4U) errors_[kept++] = e;
    }
    errors_.truncate(kept);
  }
  emergencies_.clear();
  update_error_register();
  if (lss_.node_id() != config_.node_id) change_node_id(lss_.node_id());
  lss_.reset(config_.node_id);
  application_.reset(kind, now);
  boot_up(now, tx);
}

void Node::error_behaviour(Time now) noexcept {
  if (state_ != NmtState::operational) return;
  if (od_.error_behaviour_communication == 0) enter(NmtState::pre_operational, now);
  if (od_.error_behaviour_communication == 2) enter(NmtState::stopped, now);
}

void Node::tick(Time now, TransmitQueue& tx) noexcept {
  if (now < wake_at_) return;
  if (!started_) {
    started_ = true;
    power_on_ = od_;
    lay_out_pdos();
    boot_up(now, tx);
  }
  if (is_unconfigured()) return;
  if (sdo_.transfer != Transfer::none && now - sdo_.last > config_.sdo_timeout) {
    sdo_abort(sdo_.entry->index, sdo_.entry->sub, Abort::timeout, tx);
  }
  tick_watched(now);
  if (state_ == NmtState::operational) {
    for (std::uint32_t left = timed_rpdos_; left != 0; left &= left - 1U) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      Rpdo& r = rpdo_[i];
      if (!r.watched || r.late || now <= deadline_of(i)) continue;
      r.late = true;
      raise(Emergency::rpdo_timeout, {static_cast<std::uint8_t>(i + 1)}, now);
    }
    for (std::uint32_t left = timed_tpdos_; left != 0; left &= left - 1U) {
      tick_tpdo(static_cast<std::size_t>(std::countr_zero(left)), now, tx);
    }
  }
  if (od_.producer_heartbeat_ms != 0 && now >= next_heartbeat_) {
    const Duration period = milliseconds(od_.producer_heartbeat_ms);
    send(heartbeat_frame(config_.node_id, state_), tx);
    next_heartbeat_ += period;
    if (next_heartbeat_ <= now) next_heartbeat_ = now + period;
  }
  if (overflowed_) {
    raise(Emergency::can_overrun, now);
  } else if (!errors_.empty()) {
    clear(Emergency::can_overrun, now);
  }
  overflowed_ = false;
  tick_emergency(now, tx);
  wake_at_ = next_wake(now);
}

Time Node::next_wake(Time now) const noexcept {
  if (overflowed_ || !errors_.empty() || !emergencies_.empty()) return kNow;
  Time soonest = od_.producer_heartbeat_ms != 0 ? next_heartbeat_ : Time{std::numeric_limits<std::int64_t>::max()};
  const auto at = [&](Time t) {
    if (t < soonest) soonest = t;
  };
  if (sdo_.transfer != Transfer::none) at(sdo_.last + config_.sdo_timeout);
  if (watches_) {
    for (std::size_t i = 0; i < kMaxWatched; ++i) {
      const Watched& w = watched_[i];
      if (w.running && !w.lost) at(w.last + watched_timeout(od_.consumer_heartbeat[i]));
    }
  }
  if (state_ != NmtState::operational) return soonest;
  for (std::uint32_t left = timed_rpdos_; left != 0; left &= left - 1U) {
    const auto i = static_cast<std::size_t>(std::countr_zero(left));
    if (rpdo_[i].watched && !rpdo_[i].late) at(deadline_of(i));
  }
  for (std::uint32_t left = timed_tpdos_; left != 0; left &= left - 1U) {
    const auto i = static_cast<std::size_t>(std::countr_zero(left));
    const PdoCommunication& pdo = od_.tpdo_communication[i];
    // On change: every tick may bring one.
    if (pdo.transmission_type != kTimerOnlyType || tpdo_[i].requested) return now;
    if (pdo.event_timer_ms != 0) at(tpdo_[i].sent + milliseconds(pdo.event_timer_ms));
  }
  return soonest;
}

void Node::tick_watched(Time now) noexcept {
  if (!watches_) return;
  for (std::size_t i = 0; i < kMaxWatched; ++i) {
    const std::uint32_t setting = od_.consumer_heartbeat[i];
    Watched& w = watched_[i];
    if (!w.running || w.lost || now - w.last <= watched_timeout(setting)) continue;
    w.lost = true;
    raise(Emergency::heartbeat_lost, {watched_node(setting)}, now);
    application_.heartbeat_lost(watched_node(setting), now);
    error_behaviour(now);
  }
}

void Node::bus_off(Time now) noexcept {
  wake();
  ++od_.count_bus_off;
  pending_rpdos_ = 0;
  error_behaviour(now);
}

void Node::bus_recovered(Time now) noexcept {
  raise(Emergency::bus_off_recovered, now);
  clear(Emergency::bus_off_recovered, now);
}

void Node::send(const Frame& f, TransmitQueue& tx) noexcept {
  if (tx.push_back(f)) return;
  ++od_.count_transmit_overflow;
  overflowed_ = true;
  wake();
}

// ---- errors ----

void Node::raise(Emergency code, const std::array<std::uint8_t, 5>& detail, Time) noexcept {
  if (code == Emergency::none || is_present(code)) return;
  wake();
  if (!errors_.push_back({code, register_bits(code)})) return;
  update_error_register();
  auto& history = od_.error_history;
  std::copy_backward(history.begin(), history.end() - 1, history.end());
  history[0] = static_cast<std::uint32_t>(code) | static_cast<std::uint32_t>(detail[0]) << 16U |
               static_cast<std::uint32_t>(detail[1]) << 24U;
  if (od_.error_history_count < history.size()) ++od_.error_history_count;
  queue_emergency(static_cast<std::uint16_t>(code), detail);
}

void Node::clear(Emergency code, Time) noexcept {
  std::size_t kept = 0;
  for (const Error& e : errors_) {
    if (e.code != code) errors_[kept++] = e;
  }
  if (kept == errors_.size()) return;
  errors_.truncate(kept);
  update_error_register();
  queue_emergency(0, {});
  wake();
}

bool Node::is_present(Emergency code) const noexcept {
  return std::any_of(errors_.begin(), errors_.end(), [&](const Error& e) { return e.code == code; });
}

void Node::update_error_register() noexcept {
  unsigned bits = errors_.empty() ? 0U : 1U;
  for (const Error& e : errors_) bits |= e.register_bits;
  od_.error_register = static_cast<std::uint8_t>(bits);
}

void Node::queue_emergency(std::uint16_t code, const std::array<std::uint8_t, 5>& detail) noexcept {
  if (!emergencies_.push({code, od_.error_register, detail})) ++od_.count_transmit_overflow;
}

void Node::tick_emergency(Time now, TransmitQueue& tx) noexcept {
  if (!is_valid(od_.emergency_cob_id)) emergencies_.clear();
  if (state_ != NmtState::pre_operational && state_ != NmtState::operational) return;
  const Duration inhibit = microseconds(100) * od_.emergency_inhibit_100us;
  while (!emergencies_.empty()) {
    if (has_sent_emergency_ && now - emergency_sent_ < inhibit) return;
    const PendingEmergency& e = emergencies_.front();
    Frame f;
    f.id = od_.emergency_cob_id & kElevenBit;
    f.length = 8;
    put<std::uint16_t>(f.data.data(), e.code);
    f.data[2] = e.error_register;
    std::copy(e.detail.begin(), e.detail.end(), f.data.begin() + 3);
    if (!tx.push_back(f)) return;  // waits for room
    emergencies_.pop();
    has_sent_emergency_ = true;
    emergency_sent_ = now;
  }
}

}  // namespace mrr::can
