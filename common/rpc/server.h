// Room: common/rpc. A JSON-RPC 2.0 server on a Unix socket for one user, driven by poll(): no thread of its own.
// Host only; not for a real-time thread (it uses the heap).
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/rpc/message.h"

namespace mrr::rpc {

struct ServerOptions {
  std::size_t max_clients = 16;  ///< a further one is told so and closed
  /// A client that leaves more than this unread loses events; if it also asks on, the connection. One reply may be
  /// longer.
  std::size_t max_unread_bytes = 1024 * 1024;
};

class Server {
 public:
  /// Params in, result out. Throws Error to refuse. Any other std::exception is sent as kInternalError with its what();
  /// std::invalid_argument and errors of nlohmann-json as kInvalidParams.
  using Handler = std::function<Json(const Params&)>;

  /// Listens on `socket`, mode 0600; makes no folder (use runtime_dir()). A socket left behind by a dead server is
  /// replaced. Throws ConnectionError if a server answers there, if something else lies there, if the path is too long,
  /// or if the folder is missing or others could replace what is in it.
  explicit Server(std::filesystem::path socket, const ServerOptions& options = {});
  ~Server();  ///< closes all clients and removes the socket
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// `subscribe` and `unsubscribe` are there already.
  void on(const std::string& method, Handler handler);

  /// Sends {"method": "event", "params": `params`} to every client that has subscribed to `topic`: `subscribe` with no
  /// params is for all topics, with {"events": ["topic", ...]} for those. Never blocks: a client that does not read
  /// loses events, and the next one it gets says how many in "dropped". `params` must be an object.
  void notify(std::string_view topic, const Json& params);

  /// Readable when serve() has something to do: for the caller's own poll().
  [[nodiscard]] int fd() const noexcept;
  /// Accepts, reads, answers and sends whatever can be done without waiting.
  void serve() { poll(std::chrono::milliseconds(0)); }
  /// Waits until there is something to do, at most `timeout`, and does it. Returns early on a signal.
  void poll(std::chrono::milliseconds timeout);

  [[nodiscard]] const std::filesystem::path& socket() const noexcept;
  [[nodiscard]] std::size_t clients() const noexcept;
  [[nodiscard]] std::size_t subscribers() const noexcept;
  /// Clients dropped because they did not read, sent too long a line, or were one too many.
  [[nodiscard]] std::uint64_t dropped() const noexcept;
  /// Connections of other users, refused.
  [[nodiscard]] std::uint64_t refused() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// What the server answers to one line; empty: nothing (notifications). Public for tests with arbitrary bytes: no I/O,
/// throws nothing but std::bad_alloc.
[[nodiscard]] std::string answer(std::string_view line, const std::map<std::string, Server::Handler>& handlers);

}  // namespace mrr::rpc
