#include "can_protocol/socketcan/can_socket.h"

#include <fmt/format.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

#include "can_protocol/socketcan/arrival.h"
#include "can_protocol/socketcan/linux_frame.h"
#include "common/core/containers.h"

namespace mrr::can {

namespace {

Time to_time(const timespec& t) noexcept { return Time{t.tv_sec * 1'000'000'000 + t.tv_nsec}; }

Time read_clock(clockid_t clock) noexcept {
  timespec t{};
  clock_gettime(clock, &t);
  return to_time(t);
}

/// CLOCK_MONOTONIC minus CLOCK_REALTIME: the tightest of a few readings.
Duration clock_offset() noexcept {
  Duration best{};
  Duration narrowest{INT64_MAX};
  for (int i = 0; i < 5; ++i) {
    const Time before = read_clock(CLOCK_MONOTONIC);
    const Time real = read_clock(CLOCK_REALTIME);
    const Time after = read_clock(CLOCK_MONOTONIC);
    if (after - before < narrowest) {
      narrowest = after - before;
      best = before + (after - before) / 2 - real;
    }
  }
  return best;
}

class Descriptor {
 public:
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&&) = delete;
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  [[nodiscard]] int get() const noexcept { return fd_; }

 private:
  int fd_;
};

[[nodiscard]] CanError no_can(int error) {
  if (error == EAFNOSUPPORT || error == EPROTONOSUPPORT) {
    return CanError(
        "the kernel has no CAN sockets; load its modules with \"sudo modprobe can-raw vcan\", or run the command in a "
        "guest that has them with \"scripts/with_vcan COMMAND\".");
  }
  return CanError(fmt::format("no CAN socket can be opened: {}.", std::strerror(error)));
}

int interface_index(int fd, const std::string& name, bool want_fd) {
  ifreq request{};
  if (name.empty() || name.size() >= sizeof request.ifr_name)
    throw CanError(
        fmt::format("\"{}\" is not the name of a CAN interface (1 to 15 letters, for example vcan0).", name));
  std::memcpy(request.ifr_name, name.c_str(), name.size());
  if (::ioctl(fd, SIOCGIFINDEX, &request) != 0) {
    throw CanError(fmt::format(
        "there is no interface {0}; for a virtual one: \"sudo ip link add {0} type vcan && sudo ip link set "
        "{0} mtu 72 up\".",
        name));
  }
  const int index = request.ifr_ifindex;
  if (::ioctl(fd, SIOCGIFFLAGS, &request) != 0 || (request.ifr_flags & IFF_UP) == 0)
    throw CanError(fmt::format("interface {0} is down; bring it up with \"sudo ip link set {0} up\".", name));
  if (want_fd && (::ioctl(fd, SIOCGIFMTU, &request) != 0 || request.ifr_mtu < static_cast<int>(CANFD_MTU))) {
    throw CanError(
        fmt::format("interface {0} is not set up for CAN FD frames (mtu {1}, needed {2}); set it down, then \"sudo ip "
                    "link set {0} mtu {2}\", then up.",
                    name, request.ifr_mtu, CANFD_MTU));
  }
  return index;
}

void set(int fd, int level, int option, const void* value, std::size_t size, const char* what) {
  if (::setsockopt(fd, level, option, value, static_cast<socklen_t>(size)) != 0)
    throw CanError(fmt::format("the CAN socket refuses {}: {}.", what, std::strerror(errno)));
}

constexpr Duration kLookAgain = milliseconds(100);  // for an interface that was removed

bool apply_filters(int fd, std::span<const CanFilter> filters) noexcept {
  std::array<can_filter, CanSocket::kMaxFilters> raw{};
  if (filters.size() > raw.size()) {
    errno = EINVAL;
    return false;
  }
  std::size_t n = 0;
  for (const CanFilter& f : filters) raw[n++] = {f.id, (f.mask & CAN_SFF_MASK) | CAN_EFF_FLAG};
  if (n == 0) raw[n++] = {0, 0};
  return ::setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, raw.data(), static_cast<socklen_t>(n * sizeof(can_filter))) == 0;
}

}  // namespace

Time monotonic_now() noexcept { return read_clock(CLOCK_MONOTONIC); }
Time kernel_now() noexcept { return read_clock(CLOCK_REALTIME); }

struct CanSocket::Impl {
  static constexpr std::size_t kControlBytes = CMSG_SPACE(sizeof(timespec)) + CMSG_SPACE(sizeof(std::uint32_t));
  struct Control {
    alignas(cmsghdr) std::array<char, kControlBytes> bytes;
  };

  Impl(Descriptor&& d, std::string interface_name) : descriptor(std::move(d)), name(std::move(interface_name)) {
    for (std::size_t i = 0; i < kBatch; ++i) {
      receive_vector[i] = {&received_raw[i], sizeof(canfd_frame)};
      send_vector[i] = {&sent_raw[i], 0};
      send_header[i].msg_hdr.msg_iov = &send_vector[i];
      send_header[i].msg_hdr.msg_iovlen = 1;
    }
    clock.set(clock_offset());
  }

  Descriptor descriptor;
  std::string name;
  ArrivalClock clock;
  Duration wait{};  ///< SO_RCVTIMEO in force
  bool kernel_times = false;
  bool bus_off = false;
  bool link_down = false;
  bool error_passive = false;
  bool detached = false;  ///< the interface was removed, and this socket with it from the kernel's lists
  Time looked;            ///< for it
  StaticVector<CanFilter, kMaxFilters> filters;
  CanSocketStatistics statistics;
  std::array<canfd_frame, kBatch> received_raw{};
  std::array<iovec, kBatch> receive_vector{};
  std::array<Control, kBatch> receive_control{};
  std::array<mmsghdr, kBatch> receive_header{};
  std::array<ReceivedFrame, kBatch> received{};
  std::array<canfd_frame, kBatch> sent_raw{};
  std::array<iovec, kBatch> send_vector{};
  std::array<mmsghdr, kBatch> send_header{};

  std::span<const ReceivedFrame> receive(int flags = MSG_DONTWAIT) noexcept;
  [[nodiscard]] Time look_at_clocks() noexcept;
  Time arrival(msghdr& header, Time now) noexcept;
  void note_error_frame(const canfd_frame& frame) noexcept;
  void note_loss(int error) noexcept;
  void attach_again() noexcept;
};

CanSocket::CanSocket(std::unique_ptr<Impl> impl) noexcept : impl_(std::move(impl)) {}
CanSocket::CanSocket(CanSocket&&) noexcept = default;
CanSocket& CanSocket::operator=(CanSocket&&) noexcept = default;
CanSocket::~CanSocket() = default;

CanSocket CanSocket::open(const std::string& interface, const CanSocketOptions& options) {
  Descriptor descriptor(::socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW));
  const int fd = descriptor.get();
  if (fd < 0) throw no_can(errno);
  const int index = interface_index(fd, interface, options.fd);
  const int on = 1;
  if (options.fd) set(fd, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on, "CAN FD frames");
  if (!options.filters.empty() && !apply_filters(fd, options.filters))
    throw CanError(
        fmt::format("the CAN socket refuses its {} filters: {}.", options.filters.size(), std::strerror(errno)));
  const can_err_mask_t errors =
      CAN_ERR_TX_TIMEOUT | CAN_ERR_CRTL | CAN_ERR_ACK | CAN_ERR_BUSOFF | CAN_ERR_BUSERROR | CAN_ERR_RESTARTED;
  set(fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors, "error frames");
  set(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on, "arrival times");
  set(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on, "its count of lost frames");
  // More than the system's limit takes a privilege; without it the kernel's own limit must do, and losses are counted.
  const int bytes = options.buffer_bytes;
  for (const auto& [forced, plain] : {std::pair{SO_RCVBUFFORCE, SO_RCVBUF}, std::pair{SO_SNDBUFFORCE, SO_SNDBUF}}) {
    if (::setsockopt(fd, SOL_SOCKET, forced, &bytes, sizeof bytes) != 0)
      set(fd, SOL_SOCKET, plain, &bytes, sizeof bytes, "its queue's size");
  }
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = index;
  if (::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    throw CanError(fmt::format("interface {} cannot be used for CAN: {}.", interface, std::strerror(errno)));
  auto impl = std::make_unique<Impl>(std::move(descriptor), interface);
  for (const CanFilter& filter : options.filters) (void)impl->filters.push_back(filter);
  return CanSocket(std::move(impl));
}

/// CLOCK_MONOTONIC. The offset between the clocks follows a step of the system's time.
Time CanSocket::Impl::look_at_clocks() noexcept {
  const Time real = kernel_now();
  const Time now = monotonic_now();
  if (clock.stepped(now, real)) clock.set(clock_offset());
  return now;
}

Time CanSocket::Impl::arrival(msghdr& header, Time now) noexcept {
  Time at = now;
  for (cmsghdr* c = CMSG_FIRSTHDR(&header); c != nullptr; c = CMSG_NXTHDR(&header, c)) {
    if (c->cmsg_level != SOL_SOCKET) continue;
    if (c->cmsg_type == SO_TIMESTAMPNS) {
      timespec t{};
      std::memcpy(&t, CMSG_DATA(c), sizeof t);
      at = kernel_times ? to_time(t) : clock.arrival(to_time(t), now);
    } else if (c->cmsg_type == SO_RXQ_OVFL) {
      std::uint32_t lost = 0;
      std::memcpy(&lost, CMSG_DATA(c), sizeof lost);
      // The kernel's count is 32 bits wide and wraps.
      statistics.receive_overflow +=
          static_cast<std::uint32_t>(lost - static_cast<std::uint32_t>(statistics.receive_overflow));
    }
  }
  return at;
}

void CanSocket::Impl::note_error_frame(const canfd_frame& frame) noexcept {
  ++statistics.error_frames;
  if ((frame.can_id & CAN_ERR_TX_TIMEOUT) != 0) ++statistics.transmit_timeouts;
  if ((frame.can_id & CAN_ERR_BUSOFF) != 0) {
    ++statistics.bus_off_events;
    bus_off = true;
  }
  if ((frame.can_id & CAN_ERR_RESTARTED) != 0) bus_off = error_passive = false;
  if ((frame.can_id & CAN_ERR_CRTL) != 0) {
    const unsigned controller = frame.data[1];
    // A controller that warns is error-active again: from passive, the warning comes first.
    constexpr unsigned kActive = CAN_ERR_CRTL_ACTIVE | CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING;
    if ((controller & kActive) != 0) error_passive = false;
    if ((controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0) error_passive = true;
  }
}

void CanSocket::Impl::note_loss(int error) noexcept {
  if (error != ENETDOWN && error != ENODEV && error != ENXIO) return;
  link_down = true;
  error_passive = false;  // a controller that is started again has no errors counted, and sends no frame to say so
  detached = detached || error != ENETDOWN;
}

/// The kernel has forgotten filters and interface, the rest stays.
void CanSocket::Impl::attach_again() noexcept {
  const Time now = monotonic_now();
  if (now - looked < kLookAgain) return;
  looked = now;
  ifreq request{};
  std::memcpy(request.ifr_name, name.c_str(), name.size());  // open() has seen that it fits
  if (::ioctl(descriptor.get(), SIOCGIFINDEX, &request) != 0) return;
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = request.ifr_ifindex;
  detached = !apply_filters(descriptor.get(), {filters.data(), filters.size()}) ||
             ::bind(descriptor.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0;
}

std::span<const ReceivedFrame> CanSocket::Impl::receive(int flags) noexcept {
  Time deadline;
  std::size_t count = 0;
  if (detached) attach_again();
  while (count == 0) {
    for (std::size_t i = 0; i < kBatch; ++i) {
      msghdr& header = receive_header[i].msg_hdr;
      header = {};
      header.msg_iov = &receive_vector[i];
      header.msg_iovlen = 1;
      header.msg_control = receive_control[i].bytes.data();
      header.msg_controllen = kControlBytes;
    }
    const int n = ::recvmmsg(descriptor.get(), receive_header.data(), kBatch, flags, nullptr);
    if (n < 0) {
      if (errno == EINTR && flags == MSG_DONTWAIT) continue;
      note_loss(errno);
      break;
    }
    if (n == 0) break;
    const Time now = kernel_times ? Time{} : look_at_clocks();  // in some virtual machines reading a clock is dear
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
      const Time at = arrival(receive_header[i].msg_hdr, now);
      if ((received_raw[i].can_id & CAN_ERR_FLAG) != 0) {
        note_error_frame(received_raw[i]);
        continue;
      }
      const std::optional<Frame> frame = from_linux(received_raw[i], receive_header[i].msg_len);
      if (!frame) {
        ++statistics.malformed;
        continue;
      }
      received[count++] = {*frame, at};
    }
    // A batch of nothing but error frames: there may be more behind it, but they do not start the wait again and again.
    if (count == 0 && flags == MSG_WAITFORONE) {
      const Time seen = monotonic_now();
      if (deadline.ns == 0) deadline = seen + wait;
      if (seen >= deadline) break;
    }
  }
  statistics.received += static_cast<std::int64_t>(count);
  if (count > 0) link_down = bus_off = false;
  return {received.data(), count};
}

std::span<const ReceivedFrame> CanSocket::receive() noexcept { return impl_->receive(); }

std::span<const ReceivedFrame> CanSocket::receive(Duration timeout) noexcept {
  if (timeout.ns <= 0) return impl_->receive();
  // One system call instead of two: the kernel waits for the first frame and hands over all there are.
  if (timeout != impl_->wait) {
    const timeval t{timeout.ns / 1'000'000'000, (timeout.ns / 1'000 % 1'000'000) + 1};
    if (::setsockopt(impl_->descriptor.get(), SOL_SOCKET, SO_RCVTIMEO, &t, sizeof t) != 0) return {};
    impl_->wait = timeout;
  }
  return impl_->receive(MSG_WAITFORONE);
}

void CanSocket::wait(Duration timeout) const noexcept {
  if (timeout.ns <= 0) return;
  pollfd readable{impl_->descriptor.get(), POLLIN, 0};
  const timespec t{timeout.ns / 1'000'000'000, timeout.ns % 1'000'000'000};
  (void)::ppoll(&readable, 1, &t, nullptr);
}

std::size_t CanSocket::send(std::span<const Frame> frames) noexcept {
  Impl& s = *impl_;
  if (s.detached) s.attach_again();
  std::size_t taken = 0;
  while (!frames.empty()) {
    const std::size_t batch = frames.size() < kBatch ? frames.size() : kBatch;
    std::size_t n = 0;
    for (std::size_t i = 0; i < batch; ++i) {
      const std::size_t bytes = to_linux(frames[i], s.sent_raw[n]);
      if (bytes != 0) s.send_vector[n++].iov_len = bytes;
    }
    s.statistics.send_dropped += static_cast<std::int64_t>(batch - n);
    frames = frames.subspan(batch);
    if (n == 0) continue;
    int done = 0;
    do {
      done = ::sendmmsg(s.descriptor.get(), s.send_header.data(), static_cast<unsigned>(n), MSG_DONTWAIT);
    } while (done < 0 && errno == EINTR);
    if (done < 0) s.note_loss(errno);
    const std::size_t accepted = done > 0 ? static_cast<std::size_t>(done) : 0;
    s.statistics.send_dropped += static_cast<std::int64_t>(n - accepted);
    taken += accepted;
  }
  s.statistics.sent += static_cast<std::int64_t>(taken);
  if (taken > 0) s.link_down = false;
  return taken;
}

bool CanSocket::set_filters(std::span<const CanFilter> filters) noexcept {
  if (!apply_filters(impl_->descriptor.get(), filters)) return false;
  impl_->filters.clear();
  for (const CanFilter& filter : filters) (void)impl_->filters.push_back(filter);
  return true;
}

void CanSocket::discard_received() noexcept {
  while (!impl_->receive().empty()) {
  }
}

void CanSocket::measure_clock_offset() noexcept { impl_->clock.set(clock_offset()); }
void CanSocket::use_kernel_times(bool on) noexcept { impl_->kernel_times = on; }
int CanSocket::fd() const noexcept { return impl_->descriptor.get(); }
const std::string& CanSocket::interface() const noexcept { return impl_->name; }
bool CanSocket::bus_off() const noexcept { return impl_->bus_off; }
bool CanSocket::error_passive() const noexcept { return impl_->error_passive; }
bool CanSocket::link_down() const noexcept { return impl_->link_down; }
const CanSocketStatistics& CanSocket::statistics() const noexcept { return impl_->statistics; }

}  // namespace mrr::can
