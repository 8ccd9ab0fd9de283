#include "can_protocol/storage.h"

#include "can_protocol/codec.h"

namespace mrr::can {

namespace {

constexpr int kPatience = 1'000'000;  // calls at start until the memory counts as dead
constexpr std::size_t kEntryHeader = 4;
static_assert(kEntryHeader + kMaxObjectSize <= StoragePort::kStepBytes);
static_assert(kStorageHeaderBytes <= StoragePort::kStepBytes);

std::size_t stored_bytes(const ObjectDictionary& od) noexcept {
  std::size_t n = 0;
  for (const Entry& e : kEntries) {
    if (e.flags & kStored) n += kEntryHeader + read_value(od, e).size;
  }
  return n;
}

bool same(const ObjectDictionary& a, const ObjectDictionary& b, const Entry& e) noexcept {
  return std::memcmp(reinterpret_cast<const unsigned char*>(&a) + e.offset,
                     reinterpret_cast<const unsigned char*>(&b) + e.offset, e.size) == 0;
}

}  // namespace

std::uint32_t hash_with_changes(std::uint32_t planned, const ObjectDictionary& configured,
                                const ObjectDictionary& now) noexcept {
  std::uint32_t hash = planned;
  const auto add = [&](std::uint32_t byte) { hash = (hash ^ (byte & 0xFFU)) * 16777619U; };
  for (const Entry& e : kEntries) {
    if (!counts_for_configuration(e) || same(configured, now, e)) continue;
    add(e.index);
    add(static_cast<std::uint32_t>(e.index) >> 8U);
    add(e.sub);
    const Value v = read_value(now, e);
    for (std::size_t i = 0; i < v.size; ++i) add(v.bytes[i]);
  }
  return hash;
}

// ---- reading ----

bool ParameterStore::read_all(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept {
  for (int i = 0; i < kPatience; ++i) {
    switch (port_->read(slot, offset, out)) {
      case StoragePort::Result::done:
        return true;
      case StoragePort::Result::busy:
        break;
      case StoragePort::Result::failed:
        return false;
    }
  }
  return false;
}

ParameterStore::Finding ParameterStore::examine(std::uint8_t slot, Header& header) noexcept {
  std::array<std::uint8_t, StoragePort::kStepBytes> bytes{};
  const std::span<std::uint8_t> head = std::span(bytes).first(kStorageHeaderBytes);
  if (!read_all(slot, 0, head)) return Finding::damaged;
  const auto all = [&](std::uint8_t value) {
    return std::all_of(head.begin(), head.end(), [value](std::uint8_t b) { return b == value; });
  };
  if (all(0xFF) || all(0x00)) return Finding::empty;
  if (get<std::uint32_t>(head.data()) != kStorageMagic) return Finding::damaged;
  if (get<std::uint16_t>(head.data() + 4) != kStorageLayout) return Finding::damaged;
  header.node_id = head[6];
  header.version = get<std::uint32_t>(head.data() + 8);
  header.schema = get<std::uint32_t>(head.data() + 12);
  header.length = get<std::uint32_t>(head.data() + 16);
  // An older layout may have had more objects than this one.
  if (header.length > 4 * kSlotBytes) return Finding::damaged;
  std::uint32_t crc = crc32_more(kCrc32Start, head);
  for (std::size_t at = 0; at < header.length;) {
    const std::size_t n = std::min<std::size_t>(header.length - at, bytes.size());
    const std::span<std::uint8_t> part = std::span(bytes).first(n);
    if (!read_all(slot, kStorageHeaderBytes + at, part)) return Finding::damaged;
    crc = crc32_more(crc, part);
    at += n;
  }
  const std::span<std::uint8_t> end = std::span(bytes).first(4);
  if (!read_all(slot, kStorageHeaderBytes + header.length, end)) return Finding::damaged;
  return get<std::uint32_t>(end.data()) == ~crc ? Finding::whole : Finding::damaged;
}

// One pass over a whole slot; `apply` writes what the pass before found good.
bool ParameterStore::take_over(std::uint8_t slot, const Header& header, ObjectDictionary& od, std::uint8_t node_id,
                               bool apply) noexcept {
  static constexpr ObjectDictionary kDefaults{};
  migrated_ = 0;
  for (std::size_t at = 0; at < header.length;) {
    std::array<std::uint8_t, kEntryHeader> head{};
    if (header.length - at < kEntryHeader || !read_all(slot, kStorageHeaderBytes + at, head)) return false;
    at += kEntryHeader;
    const auto index = get<std::uint16_t>(head.data());
    const std::uint8_t sub = head[2];
    const std::size_t size = head[3];
    refused_ = static_cast<std::uint32_t>(index) << 8U | sub;
    if (size > header.length - at) return false;
    const Entry* e = find_entry(index, sub);
    const bool known = e != nullptr && (e->flags & kStored) != 0 && size <= kMaxObjectSize &&
                       (e->type == Type::string || size == e->size);
    if (!known) {
      // Of an older schema: left out and counted. Of this one it cannot be.
      if (header.schema == kProtocolHash) return false;
      ++migrated_;
      at += size;
      continue;
    }
    Value v;
    v.size = static_cast<std::uint8_t>(size);
    if (!read_all(slot, kStorageHeaderBytes + at, std::span(v.bytes).first(size))) return false;
    at += size;
    if ((e->flags & kAddsNodeId) != 0 && header.node_id != node_id) {
      const auto base = static_cast<std::uint32_t>(read_value(kDefaults, *e).as_unsigned());
      if (v.as_unsigned() == base + header.node_id) put<std::uint32_t>(v.bytes.data(), base + node_id);
    }
    if (check_value(*e, v) != Abort::none) return false;
    if (apply) write_value(od, *e, v);
  }
  refused_ = 0;
  return true;
}

void ParameterStore::load(StoragePort& port, ObjectDictionary& od, std::uint8_t node_id) noexcept {
  port_ = &port;
  state_ = StorageState::reading;
  std::array<Header, StoragePort::kSlots> header{};
  std::array<Finding, StoragePort::kSlots> finding{};
  for (std::uint8_t i = 0; i < StoragePort::kSlots; ++i) finding[i] = examine(i, header[i]);
  const bool damaged = finding[0] == Finding::damaged || finding[1] == Finding::damaged;
  std::uint8_t newest = 0;
  if (finding[0] == Finding::whole && finding[1] == Finding::whole) {
    // The count may wrap round.
    newest = static_cast<std::int32_t>(header[1].version - header[0].version) > 0 ? 1 : 0;
  } else if (finding[1] == Finding::whole) {
    newest = 1;
  } else if (finding[0] != Finding::whole) {
    // One damaged slot beside an empty one is a first write that was cut off; two are a damaged memory.
    const bool both = finding[0] == Finding::damaged && finding[1] == Finding::damaged;
    slot_ = finding[0] == Finding::damaged ? 1 : 0;
    state_ = both ? StorageState::refused : damaged ? StorageState::torn : StorageState::empty;
    if (state_ == StorageState::empty) slot_ = 1;
    return;
  }
  slot_ = newest;
  version_ = header[newest].version;
  if (!take_over(newest, header[newest], od, node_id, false)) {
    state_ = StorageState::refused;
    return;
  }
  static_cast<void>(take_over(newest, header[newest], od, node_id, true));
  // From the second write on both slots are in use: one that is empty was being written when the power went.
  const bool cut_off = damaged || (finding[1U - newest] == Finding::empty && version_ > 1);
  state_ = cut_off ? StorageState::torn : header[newest].length == 0 ? StorageState::empty : StorageState::good;
}

// ---- writing ----

bool ParameterStore::begin_write(const ObjectDictionary* od, std::uint8_t node_id) noexcept {
  if (port_ == nullptr || state_ == StorageState::writing) return false;
  nothing_ = od == nullptr;
  if (od != nullptr) snapshot_ = *od;
  length_ = nothing_ ? 0 : stored_bytes(snapshot_);
  node_id_ = node_id;
  target_ = static_cast<std::uint8_t>(1U - slot_);
  step_ = Step::erase;
  offset_ = entry_ = piece_size_ = 0;
  crc_ = kCrc32Start;
  state_ = StorageState::writing;
  return true;
}

// The next bytes of the slot, made once and offered until the port has taken them.
std::span<const std::uint8_t> ParameterStore::next_piece() noexcept {
  if (piece_size_ != 0) return std::span(piece_).first(piece_size_);
  switch (step_) {
    case Step::header:
      put<std::uint32_t>(piece_.data(), kStorageMagic);
      put<std::uint16_t>(piece_.data() + 4, kStorageLayout);
      piece_[6] = node_id_;
      piece_[7] = 0;
      put<std::uint32_t>(piece_.data() + 8, version_ + 1);
      put<std::uint32_t>(piece_.data() + 12, kProtocolHash);
      put<std::uint32_t>(piece_.data() + 16, static_cast<std::uint32_t>(length_));
      piece_size_ = kStorageHeaderBytes;
      break;
    case Step::entries:
      while (!nothing_ && entry_ < kEntryCount) {
        const Entry& e = kEntries[entry_];
        if (e.flags & kStored) {
          const Value v = read_value(snapshot_, e);
          if (piece_size_ + kEntryHeader + v.size > piece_.size()) break;
          put<std::uint16_t>(piece_.data() + piece_size_, e.index);
          piece_[piece_size_ + 2] = e.sub;
          piece_[piece_size_ + 3] = v.size;
          std::copy_n(v.bytes.begin(), v.size,
                      piece_.begin() + static_cast<std::ptrdiff_t>(piece_size_ + kEntryHeader));
          piece_size_ += kEntryHeader + v.size;
        }
        ++entry_;
      }
      break;
    case Step::end:
      put<std::uint32_t>(piece_.data(), ~crc_);
      written_crc_ = ~crc_;
      piece_size_ = 4;
      break;
    case Step::erase:
    case Step::flush:
    case Step::verify:
      break;
  }
  if (step_ != Step::end) crc_ = crc32_more(crc_, std::span<const std::uint8_t>(piece_).first(piece_size_));
  return std::span(piece_).first(piece_size_);
}

void ParameterStore::tick() noexcept {
  if (state_ != StorageState::writing) return;
  StoragePort::Result result = StoragePort::Result::done;
  switch (step_) {
    case Step::erase:
      result = port_->erase(target_);
      if (result == StoragePort::Result::done) step_ = Step::header;
      break;
    case Step::header:
    case Step::entries:
    case Step::end: {
      const std::span<const std::uint8_t> piece = next_piece();
      if (piece.empty()) {
        step_ = Step::end;
        break;
      }
      result = port_->write(target_, offset_, piece);
      if (result != StoragePort::Result::done) break;
      offset_ += piece_size_;
      piece_size_ = 0;
      if (step_ == Step::header) {
        step_ = Step::entries;
      } else if (step_ == Step::end) {
        step_ = Step::flush;
      }
      break;
    }
    case Step::flush:
      result = port_->flush(target_);
      if (result == StoragePort::Result::done) {
        step_ = Step::verify;
        offset_ = 0;
        crc_ = kCrc32Start;
      }
      break;
    case Step::verify: {
      // Read back before it counts.
      const std::size_t all = kStorageHeaderBytes + length_;
      const std::size_t n = offset_ < all ? std::min<std::size_t>(all - offset_, piece_.size()) : 4;
      const std::span<std::uint8_t> part = std::span(piece_).first(n);
      result = port_->read(target_, offset_, part);
      if (result != StoragePort::Result::done) break;
      if (offset_ < all) {
        crc_ = crc32_more(crc_, part);
        offset_ += n;
        break;
      }
      if (get<std::uint32_t>(part.data()) != ~crc_ || ~crc_ != written_crc_) return fail();
      slot_ = target_;
      ++version_;
      refused_ = 0;
      migrated_ = 0;
      state_ = nothing_ ? StorageState::empty : StorageState::good;
      return;
    }
  }
  if (result == StoragePort::Result::failed) fail();
}

}  // namespace mrr::can
