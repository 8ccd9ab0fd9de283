#include "common/rpc/server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <fstream>
#include <memory>
#include <thread>

#include "common/rpc/client.h"
#include "tests/unit/rpc/temporary_folder.h"

namespace mrr::rpc {
namespace {

using namespace std::chrono_literals;
using test::TemporaryFolder;
using testing::HasSubstr;
namespace fs = std::filesystem;

template <typename Action>
std::string refusal(Action action) {
  try {
    action();
  } catch (const ConnectionError& error) {
    return error.what();
  }
  return "accepted";
}

/// A connection without any client library.
class Raw {
 public:
  explicit Raw(const fs::path& socket) : fd_(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, socket.c_str(), sizeof(address.sun_path) - 1);
    connected_ = ::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
  }
  ~Raw() { ::close(fd_); }
  Raw(const Raw&) = delete;
  Raw& operator=(const Raw&) = delete;
  [[nodiscard]] bool connected() const { return connected_; }
  bool send(const std::string& text) {
    return ::send(fd_, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
  }
  /// As much as fits without waiting.
  std::size_t send_some(const std::string& text) {
    const ssize_t n = ::send(fd_, text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    return n < 0 ? 0 : static_cast<std::size_t>(n);
  }
  /// The next line; empty: closed, or nothing for two seconds.
  std::string line() {
    for (;;) {
      if (const std::size_t end = text_.find('\n'); end != std::string::npos) {
        std::string first = text_.substr(0, end);
        text_.erase(0, end + 1);
        return first;
      }
      if (!read()) return {};
    }
  }
  bool closed() {
    while (read()) {
    }
    return at_end_;
  }

 private:
  bool read() {
    pollfd wait{fd_, POLLIN, 0};
    if (::poll(&wait, 1, 2000) <= 0) return false;
    char bytes[65536];
    const ssize_t n = ::recv(fd_, bytes, sizeof(bytes), 0);
    if (n <= 0) {
      at_end_ = true;
      return false;
    }
    text_.append(bytes, static_cast<std::size_t>(n));
    return true;
  }

  int fd_;
  bool connected_ = false;
  bool at_end_ = false;
  std::string text_;
};

/// A server that runs in a thread of its own; only that thread touches it.
class RpcServer : public testing::Test {
 protected:
  void SetUp() override {
    server_ = std::make_unique<Server>(path(), ServerOptions{.max_clients = 4, .max_unread_bytes = 100'000});
    server_->on("echo", [](const Params& params) { return Json(params); });
    server_->on("long",
                [](const Params& params) { return Json(std::string(params.at("bytes").get<std::size_t>(), 'x')); });
    server_->on("refuse", [](const Params&) -> Json { throw Error(7, "no clock", {{"code", "no_clock"}}); });
    server_->on("tell", [this](const Params& params) {
      for (int k = 0; k < params.value("times", 1); ++k)
        server_->notify(params.at("topic").get<std::string>(), {{"kind", params.at("topic")}, {"number", k}});
      return Json::object();
    });
    server_->on("counts", [this](const Params&) {
      return Json({{"clients", server_->clients()}, {"dropped", server_->dropped()}, {"refused", server_->refused()}});
    });
    server_->on("nap", [](const Params&) {
      std::this_thread::sleep_for(200ms);
      return Json("late");
    });
    thread_ = std::thread([this] {
      while (!ending_) server_->poll(20ms);
    });
  }
  void TearDown() override { end(); }
  void end() {
    ending_ = true;
    if (thread_.joinable()) thread_.join();
    server_.reset();
  }
  [[nodiscard]] fs::path path() const { return folder_ / "test.sock"; }

  TemporaryFolder folder_;
  std::unique_ptr<Server> server_;
  std::atomic<bool> ending_ = false;
  std::thread thread_;
};

constexpr const char* kEcho = R"({"jsonrpc":"2.0","id":1,"method":"echo","params":[5]})"
                              "\n";

TEST_F(RpcServer, AnswersACall) {
  Client client(path());
  EXPECT_EQ(client.call("echo", {{"a", 1}, {"b", {1, 2}}}), Json({{"a", 1}, {"b", {1, 2}}}));
  EXPECT_EQ(client.call("long", {{"bytes", 3'000'000}}).get<std::string>().size(), 3'000'000U) << "replies may be long";
}

TEST_F(RpcServer, ARefusalArrivesAsItWasThrown) {
  Client client(path());
  try {
    client.call("refuse");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), 7);
    EXPECT_STREQ(error.what(), "no clock");
    EXPECT_EQ(error.data(), Json({{"code", "no_clock"}}));
  }
}

TEST_F(RpcServer, TheSocketIsForItsOwnerAlone) {
  struct stat status {};
  ASSERT_EQ(lstat(path().c_str(), &status), 0);
  EXPECT_TRUE(S_ISSOCK(status.st_mode));
  EXPECT_EQ(status.st_mode & 07777, 0600U);
}

// Even if somebody opens the socket's file to all: the kernel says who calls.
TEST_F(RpcServer, AnotherUserIsRefused) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can become another user";
  ASSERT_EQ(chmod(folder_.path().c_str(), 0755), 0);
  const auto exit_status_as_nobody = [this] {
    const pid_t child = fork();
    if (child == 0) {
      if (setuid(65534) != 0) _exit(9);
      Raw raw(path());
      if (!raw.connected()) _exit(1);
      raw.send(kEcho);
      _exit(raw.line().empty() ? 2 : 3);
    }
    int status = 0;
    waitpid(child, &status, 0);
    return WEXITSTATUS(status);
  };
  EXPECT_EQ(exit_status_as_nobody(), 1) << "mode 0600 keeps others out";
  ASSERT_EQ(chmod(path().c_str(), 0666), 0);
  EXPECT_EQ(exit_status_as_nobody(), 2) << "connects, and is closed without an answer";
  EXPECT_EQ(Client(path()).call("counts")["refused"], 1);
}

TEST_F(RpcServer, ASecondServerAtTheSamePlaceIsRefused) {
  EXPECT_THAT(refusal([this] { Server second(path()); }), HasSubstr("a server is running there already"));
  EXPECT_EQ(Client(path()).call("echo", {1}), Json({1})) << "the first is still there";
}

TEST_F(RpcServer, TheSocketGoesWithItsServer) {
  end();
  EXPECT_FALSE(fs::exists(fs::symlink_status(path())));
  EXPECT_THAT(refusal([this] { Client client(path(), "mrr_plant"); }), HasSubstr("no mrr_plant is running there"));
}

TEST_F(RpcServer, TakesRequestsInPiecesAndSeveralAtOnce) {
  Raw raw(path());
  const std::string request = kEcho;
  for (const char c : request) ASSERT_TRUE(raw.send(std::string(1, c)));
  EXPECT_THAT(raw.line(), HasSubstr("\"result\":[5]"));
  std::string many;
  for (int k = 0; k < 200; ++k) many += request;
  ASSERT_TRUE(raw.send(many + "\r\n  \n"));
  for (int k = 0; k < 200; ++k) ASSERT_THAT(raw.line(), HasSubstr("\"result\":[5]")) << k;
  EXPECT_EQ(Json::parse((raw.send("nonsense\n"), raw.line()))["error"]["code"], kParseError);
  EXPECT_THAT((raw.send(kEcho), raw.line()), HasSubstr("\"result\":[5]")) << "a mistake does not end the connection";
}

TEST_F(RpcServer, ALineThatIsTooLongEndsTheConnectionWithTheReason) {
  for (const bool finished : {true, false}) {
    Raw raw(path());
    // In pieces: the server may close before all of it is sent.
    for (std::size_t sent = 0; sent <= kMaxRequestBytes; sent += 1024) raw.send(std::string(1024, 'a'));
    if (finished) raw.send("\n");
    EXPECT_EQ(Json::parse(raw.line())["error"]["code"], kInvalidRequest);
    EXPECT_TRUE(raw.closed());
  }
  Raw raw(path());
  const std::string head = R"({"jsonrpc":"2.0","id":1,"method":"echo","params":[")";
  ASSERT_TRUE(raw.send(head + std::string(kMaxRequestBytes - head.size() - 3, 'b') + "\"]}\n"));
  EXPECT_THAT(raw.line(), HasSubstr("\"result\"")) << "the longest allowed";
}

TEST_F(RpcServer, OneClientTooManyIsToldSoAndTheOthersStay) {
  std::vector<std::unique_ptr<Raw>> raws;
  for (int k = 0; k < 4; ++k) {
    raws.push_back(std::make_unique<Raw>(path()));
    raws.back()->send(kEcho);
    ASSERT_THAT(raws.back()->line(), HasSubstr("result"));
  }
  Raw fifth(path());
  EXPECT_THAT(fifth.line(), HasSubstr("too many clients"));
  EXPECT_TRUE(fifth.closed());
  EXPECT_THAT(refusal([this] {
                Client client(path());
                try {
                  client.call("echo");
                } catch (const Error& error) {
                  throw ConnectionError(error.what());
                }
              }),
              HasSubstr("too many clients"));
  raws.pop_back();
  Raw next(path());
  next.send(kEcho);
  std::string reply = next.line();
  for (int k = 0; k < 50 && reply.find("result") == std::string::npos; ++k) {
    std::this_thread::sleep_for(10ms);  // the server may not have seen the other leave yet
    Raw again(path());
    again.send(kEcho);
    reply = again.line();
  }
  EXPECT_THAT(reply, HasSubstr("result"));
}

TEST_F(RpcServer, EventsGoToThoseWhoAskedForThem) {
  Client all(path());
  Client some(path());
  Client none(path());
  EXPECT_EQ(all.call("subscribe"), Json::parse(R"({"events":["all"]})"));
  EXPECT_EQ(some.call("subscribe", {{"events", {"swing", "job"}}}), Json::parse(R"({"events":["job","swing"]})"));
  for (const char* topic : {"fault", "swing", "job"}) none.call("tell", {{"topic", topic}});
  for (const char* topic : {"fault", "swing", "job"}) EXPECT_EQ((*all.next_event(2s))["kind"], topic);
  for (const char* topic : {"swing", "job"}) EXPECT_EQ((*some.next_event(2s))["kind"], topic);
  EXPECT_FALSE(some.next_event(50ms).has_value());
  EXPECT_FALSE(none.next_event(50ms).has_value());
  all.call("unsubscribe");
  none.call("tell", {{"topic", "fault"}});
  EXPECT_FALSE(all.next_event(50ms).has_value());
  for (const Json& bad : {Json({{"events", "swing"}}), Json({{"events", {1}}}), Json({{"topics", {"swing"}}})})
    EXPECT_THROW(all.call("subscribe", bad), Error) << bad;
}

TEST_F(RpcServer, EventsThatArriveDuringACallAreKept) {
  Client client(path());
  client.call("subscribe");
  EXPECT_EQ(client.call("tell", {{"topic", "fault"}, {"times", 3}}), Json::object());
  for (int k = 0; k < 3; ++k) EXPECT_EQ((*client.next_event(2s))["number"], k);
}

TEST_F(RpcServer, WhoDoesNotReadLosesEventsIsToldSoAndDelaysNobody) {
  Raw lazy(path());
  lazy.send(R"({"jsonrpc":"2.0","id":1,"method":"subscribe"})"
            "\n");
  ASSERT_THAT(lazy.line(), HasSubstr("result"));
  Client busy(path());
  constexpr int kTimes = 20'000;
  busy.call("tell", {{"topic", "fault"}, {"times", kTimes}});  // some 2 MB: more than the sockets and the limit hold
  int received = 0;
  for (; !lazy.line().empty(); ++received) {  // all that had been kept for it
  }
  ASSERT_GT(received, 100);
  ASSERT_LT(received, kTimes);
  busy.call("tell", {{"topic", "fault"}});
  const Json next = Json::parse(lazy.line())["params"];
  EXPECT_EQ(next["dropped"], kTimes - received);
  busy.call("tell", {{"topic", "fault"}});
  EXPECT_FALSE(Json::parse(lazy.line())["params"].contains("dropped")) << "said once";
}

TEST_F(RpcServer, WhoAsksAndDoesNotReadIsDropped) {
  Raw greedy(path());
  const std::string request = R"({"jsonrpc":"2.0","id":1,"method":"long","params":{"bytes":50000}})"
                              "\n";
  for (int k = 0; k < 100; ++k) greedy.send_some(request);
  Client other(path());
  bool dropped = false;
  for (int k = 0; k < 100 && !dropped; ++k) {
    dropped = other.call("counts")["dropped"] == 1;
    std::this_thread::sleep_for(10ms);
  }
  EXPECT_TRUE(dropped);
  EXPECT_EQ(other.call("counts")["clients"], 1);
}

TEST_F(RpcServer, ACallThatIsNotAnsweredInTimeSaysSoAndItsLateAnswerIsNotTheNextOnes) {
  Client client(path(), "mrr_supervisor");
  EXPECT_THAT(refusal([&] { client.call("nap", {}, 50ms); }),
              HasSubstr("mrr_supervisor has not answered \"nap\" within 50 ms"));
  EXPECT_EQ(client.call("echo", {3}), Json({3}));
}

TEST_F(RpcServer, AServerThatGoesAwayIsSaid) {
  Client client(path(), "mrr_supervisor");
  client.call("echo", {1});
  end();
  EXPECT_THAT(refusal([&] { client.call("echo", {1}); }), HasSubstr("has closed the connection"));
  EXPECT_THAT(refusal([&] { client.next_event(1s); }), HasSubstr("has closed the connection"));
}

TEST(RpcPlace, WhatADeadServerLeftIsReplaced) {
  const TemporaryFolder folder;
  const fs::path path = folder / "test.sock";
  {
    const int fd = ::socket(AF_UNIX, SOCK_STREAM, 0);  // bound, never listening, closed: what kill -9 leaves
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
    ASSERT_EQ(::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    ::close(fd);
  }
  ASSERT_TRUE(fs::exists(path));
  EXPECT_THAT(refusal([&] { Client client(path, "mrr_plant"); }), HasSubstr("no mrr_plant is running there"));
  const Server server(path);
  EXPECT_TRUE(Raw(path).connected());
}

TEST(RpcPlace, ASocketOfAnotherServerInItsPlaceIsNotRemoved) {
  const TemporaryFolder folder;
  const fs::path path = folder / "test.sock";
  auto first = std::make_unique<Server>(path);
  fs::remove(path);
  const Server second(path);
  first.reset();
  EXPECT_TRUE(Raw(path).connected());
}

TEST(RpcPlace, WhatCannotBeUsedIsRefusedWithTheRemedy) {
  const TemporaryFolder folder;
  const auto server_at = [](const fs::path& path) { return refusal([&] { Server server(path); }); };
  std::ofstream(folder / "file") << "precious";
  EXPECT_THAT(server_at(folder / "file"), HasSubstr("is not a socket; remove it or choose another --socket"));
  EXPECT_TRUE(fs::exists(folder / "file"));
  EXPECT_THAT(server_at(folder / "none" / "a.sock"), HasSubstr("make it first"));
  EXPECT_THAT(server_at(folder / std::string(120, 'a')), HasSubstr("1 to 107 bytes"));
  EXPECT_THAT(refusal([&] { Client client(folder / std::string(120, 'a')); }), HasSubstr("1 to 107 bytes"));
  EXPECT_THAT(server_at(""), HasSubstr("1 to 107 bytes"));
  fs::create_directory(folder / "open");
  ASSERT_EQ(chmod((folder / "open").c_str(), 0777), 0);
  EXPECT_THAT(server_at(folder / "open" / "a.sock"), HasSubstr("others could replace the socket"));
  ASSERT_EQ(chmod((folder / "open").c_str(), 01777), 0);
  EXPECT_EQ(server_at(folder / "open" / "a.sock"), "accepted") << "as /tmp";
}

TEST(RpcPlace, AFolderOfAnotherUserIsRefused) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a folder for another user";
  const TemporaryFolder folder;
  fs::create_directory(folder / "theirs");
  fs::permissions(folder / "theirs", fs::perms::owner_all);
  ASSERT_EQ(chown((folder / "theirs").c_str(), 65534, 65534), 0);
  EXPECT_THAT(refusal([&] { Server server(folder / "theirs" / "a.sock"); }), HasSubstr("belongs to user 65534"));
}

TEST(RpcPlace, OnlyOneOfManyThatStartAtOnceComesUp) {
  const TemporaryFolder folder;
  std::atomic<int> up = 0;
  std::atomic<int> tried = 0;
  std::vector<std::thread> threads;
  for (int k = 0; k < 8; ++k) {
    threads.emplace_back([&] {
      std::unique_ptr<Server> server;
      try {
        server = std::make_unique<Server>(folder / "test.sock");
        ++up;
      } catch (const ConnectionError&) {
      }
      ++tried;
      while (tried < 8) std::this_thread::sleep_for(1ms);
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(up, 1);
}

}  // namespace
}  // namespace mrr::rpc
