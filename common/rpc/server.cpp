#include "common/rpc/server.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/epoll.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <list>
#include <set>

namespace mrr::rpc {

namespace fs = std::filesystem;

namespace {

class Descriptor {
 public:
  explicit Descriptor(int fd) noexcept : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  [[nodiscard]] int get() const noexcept { return fd_; }

 private:
  int fd_;
};

ConnectionError failed(const fs::path& path, const std::string& what) {
  return ConnectionError(fmt::format("{}: {}", path.string(), what));
}

sockaddr_un address_of(const fs::path& socket) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string& name = socket.native();
  if (name.empty() || name.size() >= sizeof(address.sun_path)) {
    throw failed(socket,
                 fmt::format("a socket's path has 1 to {} bytes, this one {}; choose a shorter one with --socket",
                             sizeof(address.sun_path) - 1, name.size()));
  }
  std::memcpy(address.sun_path, name.data(), name.size());
  return address;
}

int new_socket(const fs::path& path) {
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0) throw failed(path, fmt::format("no socket to be had: {}", std::strerror(errno)));
  return fd;
}

/// The folder, opened, and locked until closed: two servers that start at once take turns.
Descriptor locked_folder(const fs::path& socket) {
  const fs::path folder = socket.has_parent_path() ? socket.parent_path() : fs::path(".");
  Descriptor fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (fd.get() < 0) throw failed(folder, fmt::format("cannot be opened: {}; make it first", std::strerror(errno)));
  struct stat status {};
  ::fstat(fd.get(), &status);
  // A folder's owner may replace whatever is in it; root's can be trusted.
  if (status.st_uid != ::geteuid() && status.st_uid != 0) {
    throw failed(folder, fmt::format("belongs to user {}, who could replace the socket in it; use a folder of your own",
                                     status.st_uid));
  }
  // In a folder that others may write to, only the sticky bit keeps them from putting a socket of theirs in our place.
  if ((status.st_mode & (S_IWGRP | S_IWOTH)) != 0 && (status.st_mode & S_ISVTX) == 0) {
    throw failed(folder, fmt::format("has mode {:04o}: others could replace the socket in it; use a folder of your own",
                                     status.st_mode & 07777));
  }
  while (::flock(fd.get(), LOCK_EX) != 0) {
    if (errno != EINTR) throw failed(folder, fmt::format("cannot be locked: {}", std::strerror(errno)));
  }
  return fd;
}

/// Removes what a dead server left. Throws if a live one answers or something else is there.
void clear_stale(const fs::path& socket, const sockaddr_un& address) {
  struct stat status {};
  if (::lstat(socket.c_str(), &status) != 0) {
    if (errno == ENOENT) return;
    throw failed(socket, std::strerror(errno));
  }
  if (!S_ISSOCK(status.st_mode))
    throw failed(socket, "is there and is not a socket; remove it or choose another --socket");
  const Descriptor probe(new_socket(socket));
  if (::connect(probe.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0 || errno == EAGAIN)
    throw failed(socket, "a server is running there already; end it first or choose another --socket");
  if (errno != ECONNREFUSED) {
    throw failed(socket, fmt::format("is there and cannot be tried: {}; remove it or choose another --socket",
                                     std::strerror(errno)));
  }
  if (::unlink(socket.c_str()) != 0)
    throw failed(socket, fmt::format("left behind, and cannot be removed: {}", std::strerror(errno)));
}

constexpr std::size_t kReadBytes = 16 * 1024;
/// Lines answered to one client before the others have their turn.
constexpr int kLinesPerTurn = 32;

}  // namespace

struct Connection {
  Descriptor fd;
  std::string in;
  std::string out;
  std::size_t sent = 0;  // of out
  bool wants_write = false;
  bool gone = false;     // to be removed
  bool closing = false;  // to be removed when out is sent
  bool subscribed = false;
  std::uint64_t lost_events = 0;              // since the last that was sent
  std::set<std::string, std::less<>> topics;  // empty: all

  explicit Connection(Descriptor descriptor) : fd(std::move(descriptor)) {}
  [[nodiscard]] std::size_t unread() const noexcept { return out.size() - sent; }
};

struct Server::State {
  fs::path socket;
  ServerOptions options;
  Descriptor listener{-1};
  Descriptor epoll{-1};
  std::map<std::string, Handler> handlers;
  std::list<Connection> clients;
  Connection* current = nullptr;  // whose request is being answered
  std::uint64_t dropped = 0;
  std::uint64_t refused = 0;
  dev_t device = 0;
  ino_t inode = 0;

  void watch(int operation, int fd, std::uint32_t events, void* who) const {
    epoll_event event{};
    event.events = events;
    event.data.ptr = who;
    if (::epoll_ctl(epoll.get(), operation, fd, &event) != 0)
      throw failed(socket, fmt::format("cannot be watched: {}", std::strerror(errno)));
  }

  /// Client still has something to be answered that is already here.
  static bool has_line(const Connection& client) { return client.in.find('\n') != std::string::npos; }

  void drop(Connection& client) {
    if (!client.gone) ++dropped;
    client.gone = true;
  }

  void flush(Connection& client) {
    while (!client.gone && client.unread() > 0) {
      const ssize_t n = ::send(client.fd.get(), client.out.data() + client.sent, client.unread(), MSG_NOSIGNAL);
      if (n > 0) {
        client.sent += static_cast<std::size_t>(n);
      } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
        break;
      } else if (errno != EINTR) {
        client.gone = true;
      }
    }
    if (client.gone) return;
    if (client.unread() == 0) {
      client.out.clear();
      client.sent = 0;
      client.gone = client.closing;
    }
    const bool wants_write = client.unread() > 0;
    if (wants_write != client.wants_write) {
      client.wants_write = wants_write;
      watch(EPOLL_CTL_MOD, client.fd.get(), EPOLLIN | (wants_write ? EPOLLOUT : 0U), &client);
    }
  }

  void send(Connection& client, const std::string& line) {
    if (client.gone || client.closing || line.empty()) return;
    if (client.unread() > 0 && client.unread() + line.size() > options.max_unread_bytes) return drop(client);
    if (client.sent > 0) {
      client.out.erase(0, client.sent);
      client.sent = 0;
    }
    client.out += line;
    flush(client);
  }

  void accept_all() {
    for (;;) {
      Descriptor fd(::accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
      if (fd.get() < 0) {
        if (errno == EINTR || errno == ECONNABORTED) continue;
        return;  // none left, or no descriptors: they wait in the backlog
      }
      ucred peer{};
      socklen_t size = sizeof(peer);
      const bool known = ::getsockopt(fd.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0;
      if (!known || (peer.uid != ::geteuid() && peer.uid != 0)) {
        ++refused;
        continue;
      }
      if (clients.size() >= options.max_clients) {
        ++dropped;
        static constexpr std::string_view kFull =
            R"({"jsonrpc":"2.0","id":null,"error":{"code":-32600,"message":"too many clients; close one"}})"
            "\n";
        (void)!::send(fd.get(), kFull.data(), kFull.size(), MSG_NOSIGNAL);
        continue;
      }
      Connection& client = clients.emplace_back(std::move(fd));
      watch(EPOLL_CTL_ADD, client.fd.get(), EPOLLIN, &client);
    }
  }

  /// One read, then the lines that are there.
  void read(Connection& client) {
    std::array<char, kReadBytes> bytes;  // NOLINT: filled by recv
    const ssize_t n = ::recv(client.fd.get(), bytes.data(), bytes.size(), 0);
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) {
      client.gone = true;
      return;
    }
    if (n > 0 && !client.closing) client.in.append(bytes.data(), static_cast<std::size_t>(n));
  }

  void answer_lines(Connection& client) {
    std::size_t begin = 0;
    for (int k = 0; k < kLinesPerTurn && !client.gone && !client.closing; ++k) {
      const std::size_t end = client.in.find('\n', begin);
      const std::size_t length = (end == std::string::npos ? client.in.size() : end) - begin;
      if (length > kMaxRequestBytes) {
        send(client, fmt::format(R"({{"jsonrpc":"2.0","id":null,"error":{{"code":{},"message":)"
                                 R"("a request has at most {} bytes; the connection is closed"}}}})"
                                 "\n",
                                 kInvalidRequest, kMaxRequestBytes));
        ++dropped;
        client.closing = true;
        client.in.clear();
        if (client.unread() == 0) client.gone = true;
        return;
      }
      if (end == std::string::npos) break;
      std::string_view line(client.in.data() + begin, length);
      if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
      begin = end + 1;
      if (line.find_first_not_of(" \t") == std::string_view::npos) continue;  // an empty line is nothing
      current = &client;
      const std::string reply = answer(line, handlers);
      current = nullptr;
      send(client, reply);
    }
    client.in.erase(0, begin);
  }

  Json subscribe(const Params& params, bool on) {
    std::set<std::string, std::less<>> topics;
    if (params.is_object() && params.contains("events")) {
      const Params& events = params.at("events");
      const bool strings = events.is_array() &&
                           std::all_of(events.begin(), events.end(), [](const Params& one) { return one.is_string(); });
      if (!strings || events.empty())
        throw Error(kInvalidParams, "\"events\" must be a list of names, or absent for all");
      for (const Params& one : events) topics.insert(one.get<std::string>());
    } else if (!params.is_null() && !params.empty()) {
      throw Error(kInvalidParams, "the only parameter is \"events\", a list of names, or absent for all");
    }
    current->subscribed = on;
    current->topics = on ? std::move(topics) : std::set<std::string, std::less<>>{};
    if (!on) return Json::object();
    Json names = Json::array();
    for (const std::string& name : current->topics) names.push_back(name);
    if (names.empty()) names.push_back("all");
    return {{"events", names}};
  }
};

Server::Server(fs::path socket, const ServerOptions& options) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.socket = std::move(socket);
  s.options = options;
  const sockaddr_un address = address_of(s.socket);
  const Descriptor folder = locked_folder(s.socket);
  clear_stale(s.socket, address);
  s.listener = Descriptor(new_socket(s.socket));
  // Before bind(): the name in the file system has this mode from its first instant.
  ::fchmod(s.listener.get(), 0600);
  if (::bind(s.listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    throw failed(s.socket, fmt::format("no socket can be made there: {}; choose another place with --socket",
                                       std::strerror(errno)));
  }
  struct stat status {};
  const bool seen = ::lstat(s.socket.c_str(), &status) == 0;
  if (!seen || (status.st_mode & 0177) != 0 || ::listen(s.listener.get(), 16) != 0) {
    ::unlink(s.socket.c_str());
    throw failed(s.socket,
                 "the file system there does not keep a socket's permissions; choose another place with --socket");
  }
  s.device = status.st_dev;
  s.inode = status.st_ino;
  s.epoll = Descriptor(::epoll_create1(EPOLL_CLOEXEC));
  s.watch(EPOLL_CTL_ADD, s.listener.get(), EPOLLIN, nullptr);
  on("subscribe", [&s](const Params& params) { return s.subscribe(params, true); });
  on("unsubscribe", [&s](const Params& params) { return s.subscribe(params, false); });
}

Server::~Server() {
  struct stat status {};
  // Not a socket that somebody else has put there since.
  if (::lstat(state_->socket.c_str(), &status) == 0 && status.st_dev == state_->device &&
      status.st_ino == state_->inode)
    ::unlink(state_->socket.c_str());
}

void Server::on(const std::string& method, Handler handler) { state_->handlers[method] = std::move(handler); }

void Server::notify(std::string_view topic, const Json& params) {
  const auto line_of = [](const Json& content) {
    const Json message = {{"jsonrpc", "2.0"}, {"method", "event"}, {"params", content}};
    return message.dump(-1, ' ', false, Json::error_handler_t::replace) + '\n';
  };
  std::string line;
  for (Connection& client : state_->clients) {
    if (client.gone || client.closing || !client.subscribed) continue;
    if (!client.topics.empty() && !client.topics.contains(topic)) continue;
    if (line.empty()) line = line_of(params);
    if (client.unread() > 0 && client.unread() + line.size() > state_->options.max_unread_bytes) {
      ++client.lost_events;
    } else if (client.lost_events > 0) {
      Json with_count = params;
      with_count["dropped"] = std::exchange(client.lost_events, 0);
      state_->send(client, line_of(with_count));
    } else {
      state_->send(client, line);
    }
  }
}

int Server::fd() const noexcept { return state_->epoll.get(); }

void Server::poll(std::chrono::milliseconds timeout) {
  State& s = *state_;
  std::array<epoll_event, 32> events;  // NOLINT: filled by epoll_wait
  const int n =
      ::epoll_wait(s.epoll.get(), events.data(), static_cast<int>(events.size()), static_cast<int>(timeout.count()));
  for (int i = 0; i < n; ++i) {
    const epoll_event& event = events[static_cast<std::size_t>(i)];
    if (event.data.ptr == nullptr) {
      s.accept_all();
      continue;
    }
    Connection& client = *static_cast<Connection*>(event.data.ptr);
    if ((event.events & EPOLLOUT) != 0U) s.flush(client);
    if (!client.gone && (event.events & (EPOLLIN | EPOLLHUP | EPOLLERR)) != 0U) s.read(client);
  }
  // In turns until all is answered: what has been read no longer shows in fd().
  bool more = true;
  while (more) {
    more = false;
    for (Connection& client : s.clients) {
      if (!client.gone && !client.in.empty()) s.answer_lines(client);
      more = more || (!client.gone && State::has_line(client));
    }
  }
  s.clients.remove_if([](const Connection& client) { return client.gone; });
}

const fs::path& Server::socket() const noexcept { return state_->socket; }
std::size_t Server::clients() const noexcept { return state_->clients.size(); }
std::size_t Server::subscribers() const noexcept {
  return static_cast<std::size_t>(std::count_if(state_->clients.begin(), state_->clients.end(),
                                                [](const Connection& client) { return client.subscribed; }));
}
std::uint64_t Server::dropped() const noexcept { return state_->dropped; }
std::uint64_t Server::refused() const noexcept { return state_->refused; }

}  // namespace mrr::rpc
