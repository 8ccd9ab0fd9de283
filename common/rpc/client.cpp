#include "common/rpc/client.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

namespace mrr::rpc {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

namespace {

constexpr std::size_t kMaxEvents = 4096;
constexpr std::size_t kMaxMessageBytes = 256 * 1024 * 1024;  // a whole job's recording is some MiB

bool is_event(const Json& message) {
  const auto method = message.find("method");
  const auto params = message.find("params");
  return method != message.end() && *method == "event" && params != message.end() && params->is_object();
}

bool is_error(const Json& error) {
  if (!error.is_object()) return false;
  const auto code = error.find("code");
  const auto message = error.find("message");
  return code != error.end() && code->is_number_integer() && message != error.end() && message->is_string();
}

/// Rounded up, so that a wait is never shorter than asked; never negative.
std::chrono::milliseconds left_until(Clock::time_point end) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - Clock::now());
  return std::max(left, std::chrono::milliseconds(0));
}

}  // namespace

Client::Client(fs::path socket, std::string program) : socket_(std::move(socket)), program_(std::move(program)) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (socket_.native().empty() || socket_.native().size() >= sizeof(address.sun_path)) {
    throw ConnectionError(fmt::format("{}: a socket's path has 1 to {} bytes; give a shorter one", socket_.string(),
                                      sizeof(address.sun_path) - 1));
  }
  std::memcpy(address.sun_path, socket_.c_str(), socket_.native().size());
  fd_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd_ < 0)
    throw ConnectionError(fmt::format("{}: no socket to be had: {}", socket_.string(), std::strerror(errno)));
  std::string problem;
  if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    switch (errno) {
      case ENOENT:
      case ENOTDIR:
      case ECONNREFUSED:
        problem = fmt::format("no {} is running there; start it, or name its socket", program_);
        break;
      case EAGAIN:
        problem = fmt::format("{} does not take new connections", program_);
        break;
      case EACCES:
        problem = fmt::format("not permitted; be the user who started {}", program_);
        break;
      default:
        problem = std::strerror(errno);
    }
  } else {
    ucred peer{};
    socklen_t size = sizeof(peer);
    if (::getsockopt(fd_, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 ||
        (peer.uid != ::geteuid() && peer.uid != 0 && ::geteuid() != 0))
      problem = fmt::format("{} there runs as user {}, not as user {}", program_, peer.uid, ::geteuid());
  }
  if (!problem.empty()) {
    ::close(std::exchange(fd_, -1));
    throw ConnectionError(fmt::format("{}: {}", socket_.string(), problem));
  }
}

Client::~Client() {
  if (fd_ >= 0) ::close(fd_);
}

std::optional<Json> Client::take_message() {
  const std::size_t end = buffer_.find('\n', scanned_);
  if (end == std::string::npos) {
    scanned_ = buffer_.size();
    return std::nullopt;
  }
  Json message = Json::parse(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(end), nullptr, false);
  buffer_.erase(0, end + 1);
  scanned_ = 0;
  if (!message.is_object()) throw not_understood();
  return message;
}

ConnectionError Client::not_understood() const {
  return ConnectionError(
      fmt::format("{}: what answers there is not {}, or of another version: it sent something that "
                  "is not JSON-RPC; name the right socket",
                  socket_.string(), program_));
}

bool Client::receive(std::chrono::milliseconds timeout) {
  pollfd wait{fd_, POLLIN, 0};
  const int ready = ::poll(&wait, 1, static_cast<int>(timeout.count()));
  if (ready <= 0) return false;
  std::array<char, 65536> bytes;  // NOLINT: filled by recv
  const ssize_t n = ::recv(fd_, bytes.data(), bytes.size(), 0);
  if (n > 0) {
    buffer_.append(bytes.data(), static_cast<std::size_t>(n));
    if (buffer_.size() > kMaxMessageBytes && buffer_.find('\n', scanned_) == std::string::npos) throw not_understood();
    return true;
  }
  if (n < 0 && (errno == EAGAIN || errno == EINTR)) return false;
  throw ConnectionError(fmt::format("{}: {} has closed the connection", socket_.string(), program_));
}

void Client::keep_event(Json message) {
  if (!is_event(message)) return;
  if (events_.size() == kMaxEvents) {
    events_.pop_front();
    ++lost_events_;
  }
  events_.push_back(std::move(message["params"]));
}

Json Client::call(const std::string& method, const Json& params, std::chrono::milliseconds timeout) {
  const auto end = Clock::now() + timeout;
  const auto in_time = [&] {
    if (Clock::now() < end) return;
    throw ConnectionError(fmt::format("{}: {} has not answered \"{}\" within {} ms", socket_.string(), program_, method,
                                      timeout.count()));
  };
  const std::int64_t id = next_id_++;
  Json request = {{"jsonrpc", "2.0"}, {"id", id}, {"method", method}};
  if (!params.empty()) request["params"] = params;
  const std::string line = request.dump(-1, ' ', false, Json::error_handler_t::replace) + '\n';
  for (std::size_t sent = 0; sent < line.size();) {
    const ssize_t n = ::send(fd_, line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
    if (n > 0) {
      sent += static_cast<std::size_t>(n);
      continue;
    }
    if (errno != EAGAIN && errno != EINTR) break;  // closed: why may be there to be read
    in_time();
    pollfd wait{fd_, POLLOUT, 0};
    ::poll(&wait, 1, static_cast<int>(left_until(end).count()));
  }
  for (;;) {
    while (std::optional<Json> message = take_message()) {
      if (!message->contains("id")) {
        keep_event(std::move(*message));
        continue;
      }
      // A reply to an earlier call that was given up, unless it is to nobody: then it is about the connection.
      const Json& whose = (*message)["id"];
      if (whose != id && !whose.is_null()) continue;
      if (const auto error = message->find("error"); error != message->end()) {
        if (!is_error(*error)) throw not_understood();
        throw Error(error->at("code").get<int>(), error->at("message").get<std::string>(),
                    error->contains("data") ? (*error)["data"] : Json(nullptr));
      }
      if (!message->contains("result")) throw not_understood();
      return std::move((*message)["result"]);
    }
    in_time();
    receive(left_until(end));
  }
}

std::optional<Json> Client::next_event(std::chrono::milliseconds timeout) {
  const auto end = Clock::now() + timeout;
  for (;;) {
    if (!events_.empty()) {
      Json event = std::move(events_.front());
      events_.pop_front();
      return event;
    }
    if (std::optional<Json> message = take_message()) {
      keep_event(std::move(*message));
      continue;
    }
    if (!receive(left_until(end))) return std::nullopt;
  }
}

}  // namespace mrr::rpc
