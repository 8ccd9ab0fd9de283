#include <fmt/format.h>

#include "common/rpc/server.h"

namespace mrr::rpc {

namespace {

std::string line_of(const Json& json) {
  // Text from elsewhere (names of files, of interfaces) may not be UTF-8; a reply must be.
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + '\n';
}

Json failure(const Params& id, int code, const std::string& message, const Json& data = nullptr) {
  Json error = {{"code", code}, {"message", message}};
  if (!data.is_null()) error["data"] = data;
  Json reply = {{"jsonrpc", "2.0"}};
  reply["id"] = id;
  reply["error"] = std::move(error);
  return reply;
}

/// The reply to one request; null if it is a notification.
Json answer_one(const Params& request, const std::map<std::string, Server::Handler>& handlers) {
  if (!request.is_object()) return failure(nullptr, kInvalidRequest, "a request is an object");
  const auto id_entry = request.find("id");
  const bool wants_reply = id_entry != request.end();
  const Params id = wants_reply ? *id_entry : Params(nullptr);
  if (!id.is_null() && !id.is_string() && !id.is_number())
    return failure(nullptr, kInvalidRequest, "\"id\" must be a string, a number or null");
  const auto version = request.find("jsonrpc");
  if (version == request.end() || *version != "2.0") return failure(id, kInvalidRequest, "\"jsonrpc\" must be \"2.0\"");
  const auto method = request.find("method");
  if (method == request.end() || !method->is_string())
    return failure(id, kInvalidRequest, "\"method\" must be a string");
  const auto params_entry = request.find("params");
  const Params params = params_entry == request.end() ? Params(nullptr) : *params_entry;
  if (params_entry != request.end() && !params.is_structured())
    return failure(id, kInvalidRequest, "\"params\" must be an object or an array");

  Json reply;
  const auto handler = handlers.find(method->get_ref<const std::string&>());
  if (handler == handlers.end()) {
    reply =
        failure(id, kMethodNotFound, fmt::format("there is no method \"{}\"", method->get_ref<const std::string&>()));
  } else {
    try {
      Json result = handler->second(params);
      reply = {{"jsonrpc", "2.0"}};
      reply["id"] = id;
      reply["result"] = std::move(result);
    } catch (const Error& error) {
      reply = failure(id, error.code(), error.what(), error.data());
    } catch (const nlohmann::json::exception& error) {
      reply = failure(id, kInvalidParams, error.what());
    } catch (const std::invalid_argument& error) {
      reply = failure(id, kInvalidParams, error.what());
    } catch (const std::exception& error) {
      reply = failure(id, kInternalError, error.what());
    }
  }
  return wants_reply ? reply : Json(nullptr);
}

}  // namespace

std::string answer(std::string_view line, const std::map<std::string, Server::Handler>& handlers) {
  bool too_deep = false;
  const auto limit_depth = [&too_deep](int depth, nlohmann::json::parse_event_t, nlohmann::json&) {
    // Copying and printing recurse: what is nested without bound never becomes a value.
    too_deep = too_deep || depth > kMaxDepth;
    return !too_deep;
  };
  const Params request = Params::parse(line.begin(), line.end(), limit_depth, /*allow_exceptions=*/false);
  if (too_deep) return line_of(failure(nullptr, kInvalidRequest, fmt::format("nested deeper than {}", kMaxDepth)));
  if (request.is_discarded()) return line_of(failure(nullptr, kParseError, "the line is not one JSON value in UTF-8"));
  if (!request.is_array()) {
    const Json reply = answer_one(request, handlers);
    return reply.is_null() ? std::string() : line_of(reply);
  }
  if (request.empty()) return line_of(failure(nullptr, kInvalidRequest, "an empty batch"));
  if (request.size() > kMaxBatch) {
    return line_of(failure(nullptr, kInvalidRequest,
                           fmt::format("a batch has at most {} requests, this one {}; nothing of it was done",
                                       kMaxBatch, request.size())));
  }
  std::string replies;
  for (const Params& one : request) {
    Json reply;
    if (replies.size() <= kMaxBatchAnswerBytes) {
      reply = answer_one(one, handlers);
    } else if (one.is_object() && one.contains("id")) {
      reply = failure(one["id"].is_structured() ? Params(nullptr) : one["id"], kInvalidRequest,
                      fmt::format("the batch's answers have more than {} bytes already; this request was not done",
                                  kMaxBatchAnswerBytes));
    }
    if (reply.is_null()) continue;
    replies += replies.empty() ? '[' : ',';
    replies += line_of(reply);
    replies.pop_back();  // its newline
  }
  return replies.empty() ? replies : replies + "]\n";
}

}  // namespace mrr::rpc
