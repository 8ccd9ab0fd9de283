// Room: common/rpc. The other end: calls with a time limit, and events.
// Host only.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <optional>
#include <string>

#include "common/rpc/message.h"

namespace mrr::rpc {

class Client {
 public:
  /// Connects. Throws ConnectionError: nobody there, not permitted, or the server runs as another user.
  /// `program` is what should be running there, for the message ("mrr_supervisor").
  explicit Client(std::filesystem::path socket, std::string program = "server");
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /// The result. Throws Error if the server says no, ConnectionError if it does not answer in time or goes away.
  /// Events that arrive meanwhile are kept.
  Json call(const std::string& method, const Json& params = Json::object(),
            std::chrono::milliseconds timeout = std::chrono::seconds(5));

  /// Params of the next event, oldest first; nothing within `timeout` or on a signal: std::nullopt.
  /// Throws ConnectionError if the server goes away.
  std::optional<Json> next_event(std::chrono::milliseconds timeout);

  /// Readable when something arrived; for the caller's own poll().
  [[nodiscard]] int fd() const noexcept { return fd_; }
  /// Events that were not fetched in time and gave way to later ones.
  [[nodiscard]] std::uint64_t lost_events() const noexcept { return lost_events_; }

 private:
  std::optional<Json> take_message();
  [[nodiscard]] ConnectionError not_understood() const;
  bool receive(std::chrono::milliseconds timeout);
  void keep_event(Json message);

  std::filesystem::path socket_;
  std::string program_;
  int fd_ = -1;
  std::int64_t next_id_ = 1;
  std::string buffer_;
  std::size_t scanned_ = 0;
  std::deque<Json> events_;
  std::uint64_t lost_events_ = 0;
};

}  // namespace mrr::rpc
