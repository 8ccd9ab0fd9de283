// Room: common/rpc. JSON-RPC 2.0 over a Unix socket, one object a line: types and error codes both ends share.
// Host only; may touch nlohmann-json and nothing else of MRR.
#pragma once

#include <cstddef>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>

namespace mrr::rpc {

/// What a handler is given; null if the request had no params.
using Params = nlohmann::json;
/// What is sent back; keeps the order of its keys. Numbers that are not finite are sent as null.
using Json = nlohmann::ordered_json;

/// Version of the interface in docs/rpc.md: what `hello` says, and what a client looks for.
inline constexpr int kInterfaceVersion = 1;

/// Longest request, bytes, without its newline. Replies may be longer.
inline constexpr std::size_t kMaxRequestBytes = 64 * 1024;
/// Most requests in a batch.
inline constexpr std::size_t kMaxBatch = 16;
/// Once the answers of a batch have this many bytes, the rest of it is refused.
inline constexpr std::size_t kMaxBatchAnswerBytes = 4 * 1024 * 1024;
/// Deepest nesting of a request.
inline constexpr int kMaxDepth = 32;

/// Codes of JSON-RPC 2.0. Those from -32000 to -32099 and all positive ones belong to the programs.
inline constexpr int kParseError = -32700;
inline constexpr int kInvalidRequest = -32600;
inline constexpr int kMethodNotFound = -32601;
inline constexpr int kInvalidParams = -32602;
inline constexpr int kInternalError = -32603;

/// An answer "no": thrown by a handler and sent to the client; thrown by Client::call when it arrives there.
/// `what()`: one sentence, cause and remedy.
class Error : public std::runtime_error {
 public:
  Error(int code, const std::string& message, Json data = nullptr)
      : std::runtime_error(message), code_(code), data_(std::move(data)) {}
  [[nodiscard]] int code() const noexcept { return code_; }
  /// More about it for programs; null: nothing.
  [[nodiscard]] const Json& data() const noexcept { return data_; }

 private:
  int code_;
  Json data_;
};

/// A socket or its folder that cannot be used, a server that is not there or does not answer in time.
/// `what()`: one sentence naming the path and the remedy.
class ConnectionError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace mrr::rpc
