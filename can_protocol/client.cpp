#include "can_protocol/client.h"

namespace mrr::can {

bool SdoClient::begin(std::uint16_t index, std::uint8_t sub, bool is_upload) noexcept {
  if (busy()) return false;
  index_ = index;
  sub_ = sub;
  is_upload_ = is_upload;
  status_ = Status::busy;
  step_ = Step::start;
  abort_ = Abort::none;
  toggle_ = false;
  at_ = 0;
  return true;
}

bool SdoClient::upload(std::uint16_t index, std::uint8_t sub) noexcept {
  if (!begin(index, sub, true)) return false;
  value_ = {};
  return true;
}

bool SdoClient::download(std::uint16_t index, std::uint8_t sub, std::span<const std::uint8_t> data) noexcept {
  if (data.size() > kMaxObjectSize || !begin(index, sub, false)) return false;
  value_ = {};
  value_.size = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), value_.bytes.begin());
  return true;
}

bool SdoClient::download_integer(ObjectId id, std::int64_t value) noexcept {
  const Entry& e = entry_of(id);
  if (e.type == Type::f32 || e.type == Type::string) return false;
  std::array<std::uint8_t, 8> bytes{};
  put<std::int64_t>(bytes.data(), value);
  return download(e.index, e.sub, std::span(bytes).first(e.size));
}

bool SdoClient::download_real(ObjectId id, float value) noexcept {
  const Entry& e = entry_of(id);
  if (e.type != Type::f32) return false;
  std::array<std::uint8_t, 4> bytes{};
  put<std::uint32_t>(bytes.data(), std::bit_cast<std::uint32_t>(value));
  return download(e.index, e.sub, bytes);
}

void SdoClient::tick(Time now, TransmitQueue& tx) noexcept {
  if (!busy()) return;
  if (step_ != Step::start) {
    if (now - sent_ > timeout_) fail(Abort::timeout, true, tx);
    return;
  }
  std::array<std::uint8_t, 8> request{};
  put<std::uint16_t>(request.data() + 1, index_);
  request[3] = sub_;
  if (is_upload_) {
    request[0] = 0x40;
    step_ = Step::upload_first;
  } else {
    step_ = Step::download_first;
    if (value_.size >= 1 && value_.size <= 4) {
      request[0] = static_cast<std::uint8_t>(0x23U | ((4U - value_.size) << 2U));
      std::copy_n(value_.bytes.begin(), value_.size, request.begin() + 4);
    } else {
      request[0] = 0x21;
      put<std::uint32_t>(request.data() + 4, value_.size);
    }
  }
  send(request, now, tx);
}

void SdoClient::handle(const Frame& f, Time now, TransmitQueue& tx) noexcept {
  if (!busy() || step_ == Step::start) return;
  if (f.extended || f.remote || f.fd || f.id != kSdoReplyCobId + node_id_ || f.length != 8) return;
  const unsigned command = f.data[0] >> 5U;
  const bool toggle = f.data[0] & 0x10U;
  const bool is_first = step_ == Step::upload_first || step_ == Step::download_first;
  const bool is_ours = get<std::uint16_t>(f.data.data() + 1) == index_ && f.data[3] == sub_;
  if (command == 4) {
    // An abort of an earlier transfer may arrive late; one without an object (a segment out of place) is ours.
    const bool names_none = get<std::uint16_t>(f.data.data() + 1) == 0;
    if (!is_ours && !names_none) return;
    return fail(static_cast<Abort>(get<std::uint32_t>(f.data.data() + 4)), false, tx);
  }
  if (is_first && !is_ours) return;

  switch (step_) {
    case Step::start:
      return;
    case Step::upload_first: {
      if (command != 2) return fail(Abort::unknown_command, true, tx);
      if (f.data[0] & 2U) {
        value_.size = static_cast<std::uint8_t>((f.data[0] & 1U) ? 4U - ((f.data[0] >> 2U) & 3U) : 4U);
        std::copy_n(f.data.begin() + 4, value_.size, value_.bytes.begin());
        status_ = Status::done;
        return;
      }
      has_announced_ = f.data[0] & 1U;
      announced_ = get<std::uint32_t>(f.data.data() + 4);
      if (has_announced_ && announced_ > kMaxObjectSize) return fail(Abort::too_long, true, tx);
      step_ = Step::upload_segment;
      return send({0x60}, now, tx);
    }
    case Step::upload_segment: {
      if (command != 0) return fail(Abort::unknown_command, true, tx);
      if (toggle != toggle_) return fail(Abort::toggle, true, tx);
      const std::size_t size = 7U - ((f.data[0] >> 1U) & 7U);
      const bool last = f.data[0] & 1U;
      if (at_ + size > kMaxObjectSize) return fail(Abort::too_long, true, tx);
      std::copy_n(f.data.begin() + 1, size, value_.bytes.begin() + static_cast<std::ptrdiff_t>(at_));
      at_ += size;
      value_.size = static_cast<std::uint8_t>(at_);
      if (last) {
        if (has_announced_ && at_ != announced_) return fail(Abort::length, false, tx);
        status_ = Status::done;
        return;
      }
      toggle_ = !toggle_;
      return send({static_cast<std::uint8_t>(toggle_ ? 0x70 : 0x60)}, now, tx);
    }
    case Step::download_first:
      if (command != 3) return fail(Abort::unknown_command, true, tx);
      if (value_.size >= 1 && value_.size <= 4) {
        status_ = Status::done;
        return;
      }
      step_ = Step::download_segment;
      return send_segment(now, tx);
    case Step::download_segment:
      if (command != 1) return fail(Abort::unknown_command, true, tx);
      if (toggle != toggle_) return fail(Abort::toggle, true, tx);
      if (at_ == value_.size) {
        status_ = Status::done;
        return;
      }
      toggle_ = !toggle_;
      return send_segment(now, tx);
  }
}

void SdoClient::send_segment(Time now, TransmitQueue& tx) noexcept {
  const std::size_t size = std::min<std::size_t>(7, value_.size - at_);
  const bool last = at_ + size == value_.size;
  std::array<std::uint8_t, 8> request{};
  request[0] = static_cast<std::uint8_t>((toggle_ ? 0x10U : 0U) | ((7U - size) << 1U) | (last ? 1U : 0U));
  std::copy_n(value_.bytes.begin() + static_cast<std::ptrdiff_t>(at_), size, request.begin() + 1);
  at_ += size;
  send(request, now, tx);
}

void SdoClient::fail(Abort code, bool tell, TransmitQueue& tx) noexcept {
  status_ = Status::failed;
  abort_ = code;
  if (!tell) return;
  std::array<std::uint8_t, 8> request{0x80};
  put<std::uint16_t>(request.data() + 1, index_);
  request[3] = sub_;
  put<std::uint32_t>(request.data() + 4, static_cast<std::uint32_t>(code));
  send(request, sent_, tx);
}

void SdoClient::send(const std::array<std::uint8_t, 8>& data, Time now, TransmitQueue& tx) noexcept {
  Frame f;
  f.id = kSdoRequestCobId + node_id_;
  f.length = 8;
  std::copy(data.begin(), data.end(), f.data.begin());
  // No room: the answer will not come, and the timeout tells.
  (void)tx.push_back(f);
  sent_ = now;
}

}  // namespace mrr::can
