#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "common/core/random.h"
#include "common/rpc/server.h"

namespace mrr::rpc {
namespace {

using Handlers = std::map<std::string, Server::Handler>;

Handlers handlers() {
  return {{"echo", [](const Params& params) { return Json(params); }},
          {"name", [](const Params& params) { return Json(params.at("name").get<std::string>()); }},
          {"not_a_number",
           [](const Params&) {
             return Json({{"value", std::nan("")}});
           }},
          {"not_utf8", [](const Params&) { return Json("\xff\xfe"); }},
          {"refuse",
           [](const Params&) -> Json {
             throw Error(7, "no clock", {{"code", "no_clock"}});
           }},
          {"range", [](const Params&) -> Json { throw std::invalid_argument("speed 3 is not from 0 to 1"); }},
          {"defect", [](const Params&) -> Json { throw std::runtime_error("a defect"); }}};
}

Json ask(const std::string& line) {
  const std::string reply = answer(line, handlers());
  EXPECT_TRUE(reply.empty() || reply.back() == '\n');
  EXPECT_LE(std::count(reply.begin(), reply.end(), '\n'), 1) << "one reply, one line";
  return reply.empty() ? Json(nullptr) : Json::parse(reply);
}

int code_of(const std::string& line) { return ask(line).at("error").at("code").get<int>(); }

TEST(RpcAnswer, GivesBackTheIdAsItCame) {
  for (const char* id : {"1", "-7", "2.5", "\"abc\"", "null", "18446744073709551615"}) {
    const Json reply = ask(R"({"jsonrpc":"2.0","id":)" + std::string(id) + R"(,"method":"echo","params":{"a":1}})");
    EXPECT_EQ(reply["id"].dump(), id);
    EXPECT_EQ(reply["result"], Json({{"a", 1}}));
    EXPECT_EQ(reply["jsonrpc"], "2.0");
    EXPECT_FALSE(reply.contains("error"));
  }
}

TEST(RpcAnswer, NotificationsAreNotAnsweredEvenIfTheyFail) {
  for (const char* method : {"echo", "refuse", "defect", "unknown"})
    EXPECT_EQ(answer(R"({"jsonrpc":"2.0","method":")" + std::string(method) + "\"}", handlers()), "") << method;
}

TEST(RpcAnswer, EachMistakeHasItsCode) {
  EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"unknown"})"), kMethodNotFound);
  EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"name"})"), kInvalidParams);
  EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"name","params":{"name":3}})"), kInvalidParams);
  EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"range"})"), kInvalidParams);
  EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"defect"})"), kInternalError);
  for (const char* bad :
       {"1", "\"text\"", "true", "null", "{}", "[]", R"({"jsonrpc":"1.0","id":1,"method":"echo"})",
        R"({"id":1,"method":"echo"})", R"({"jsonrpc":"2.0","id":1})", R"({"jsonrpc":"2.0","id":1,"method":5})",
        R"({"jsonrpc":"2.0","id":{},"method":"echo"})", R"({"jsonrpc":"2.0","id":1,"method":"echo","params":3})",
        R"({"jsonrpc":"2.0","id":1,"method":"echo","params":null})"})
    EXPECT_EQ(code_of(bad), kInvalidRequest) << bad;
  for (const char* bad :
       {"", "{", "{]", "nul", "{\"a\":1}}", R"({"jsonrpc":"2.0","id":1,"method":"echo"} x)", "\xff", "\"\xc3\x28\""})
    EXPECT_EQ(code_of(bad), kParseError) << bad;
}

TEST(RpcAnswer, ARefusalCarriesCodeSentenceAndData) {
  const Json reply = ask(R"({"jsonrpc":"2.0","id":4,"method":"refuse"})");
  EXPECT_EQ(reply, Json({{"jsonrpc", "2.0"},
                         {"id", 4},
                         {"error", {{"code", 7}, {"message", "no clock"}, {"data", {{"code", "no_clock"}}}}}}));
}

TEST(RpcAnswer, ABatchIsAnsweredInOrderWithoutItsNotifications) {
  const Json replies = ask(R"([{"jsonrpc":"2.0","id":1,"method":"echo","params":[1]},)"
                           R"({"jsonrpc":"2.0","method":"echo"}, 5, {"jsonrpc":"2.0","id":2,"method":"unknown"}])");
  ASSERT_EQ(replies.size(), 3U);
  EXPECT_EQ(replies[0]["result"], Json({1}));
  EXPECT_EQ(replies[1]["error"]["code"], kInvalidRequest);
  EXPECT_EQ(replies[2]["error"]["code"], kMethodNotFound);
  EXPECT_EQ(answer(R"([{"jsonrpc":"2.0","method":"echo"}])", handlers()), "");
}

std::string batch_of(std::size_t n, const std::string& method) {
  std::string line;
  for (std::size_t k = 0; k < n; ++k)
    line += fmt::format(R"({}{{"jsonrpc":"2.0","id":{},"method":"{}"}})", k == 0 ? '[' : ',', k, method);
  return line + ']';
}

TEST(RpcAnswer, ABatchHasAtMostSoManyRequests) {
  EXPECT_EQ(ask(batch_of(kMaxBatch, "echo")).size(), kMaxBatch);
  int called = 0;
  const Handlers counting{{"count", [&called](const Params&) { return Json(++called); }}};
  const Json refused = Json::parse(answer(batch_of(kMaxBatch + 1, "count"), counting));
  EXPECT_EQ(refused.at("error").at("code"), kInvalidRequest);
  EXPECT_EQ(called, 0);
}

TEST(RpcAnswer, TheAnswersOfABatchAreBounded) {
  int called = 0;
  const Handlers big{{"big", [&called](const Params&) {
                        ++called;
                        return Json(std::string(kMaxBatchAnswerBytes / 2, 'x'));
                      }}};
  const std::string line = answer(batch_of(kMaxBatch, "big"), big);
  EXPECT_EQ(called, 2);
  EXPECT_LT(line.size(), kMaxBatchAnswerBytes + 10'000);
  const Json replies = Json::parse(line);
  ASSERT_EQ(replies.size(), kMaxBatch);
  EXPECT_TRUE(replies[1].contains("result"));
  EXPECT_EQ(replies[2].at("error").at("code"), kInvalidRequest);
  EXPECT_EQ(replies[kMaxBatch - 1].at("id"), kMaxBatch - 1);
}

TEST(RpcAnswer, WhatIsNestedWithoutBoundIsRefused) {
  for (const std::size_t depth : {std::size_t{33}, std::size_t{30'000}}) {
    const std::string nested = std::string(depth, '[') + std::string(depth, ']');
    EXPECT_EQ(code_of(R"({"jsonrpc":"2.0","id":1,"method":"echo","params":)" + nested + "}"), kInvalidRequest) << depth;
    EXPECT_LT(code_of(std::string(depth, '[')), 0) << "never closed";
  }
  const std::string allowed = std::string(25, '[') + std::string(25, ']');
  EXPECT_TRUE(ask(R"({"jsonrpc":"2.0","id":1,"method":"echo","params":)" + allowed + "}").contains("result"));
}

TEST(RpcAnswer, ARepliesNumbersAndTextAreAlwaysJson) {
  EXPECT_TRUE(ask(R"({"jsonrpc":"2.0","id":1,"method":"not_a_number"})")["result"]["value"].is_null());
  EXPECT_TRUE(ask(R"({"jsonrpc":"2.0","id":1,"method":"not_utf8"})")["result"].is_string());
}

// Whatever comes, the answer is nothing or one line of JSON with result or error.
TEST(RpcAnswer, SurvivesArbitraryBytes) {
  const Handlers table = handlers();
  Random random(17);
  const std::string valid = R"([{"jsonrpc":"2.0","id":1,"method":"echo","params":{"name":[1,2.5e3,"\u00e9",null]}}])";
  for (int round = 0; round < 20'000; ++round) {
    std::string line;
    if (round % 2 == 0) {
      line = valid;
      for (std::uint64_t k = random.next() % 6; k > 0; --k)
        line[random.next() % line.size()] = static_cast<char>(random.next() & 0xFFU);
      if (round % 4 == 0) line.resize(random.next() % line.size());
    } else {
      line.resize(random.next() % 200);
      for (char& c : line) c = static_cast<char>(random.next() & 0xFFU);
    }
    const std::string reply = answer(line, table);
    if (reply.empty()) continue;
    ASSERT_EQ(reply.find('\n'), reply.size() - 1) << line;
    Json json = Json::parse(reply);
    if (!json.is_array()) json = Json::array({json});
    for (const Json& one : json) ASSERT_NE(one.contains("result"), one.contains("error")) << line;
  }
}

}  // namespace
}  // namespace mrr::rpc
