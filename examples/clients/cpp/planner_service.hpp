// A client of planner-service in one header, on libcurl and nlohmann-json.
//
//   planner_service::Client server("http://localhost:8080");
//   auto answer = server.post("/pick_place", {{"scene", "bin"}, {"target", "blue_block"}, {"onto", "tray"}});
//   for (const auto& motion : server.trajectory(answer.id).motions) controller.command(motion.at(0.1));
//
// A refused request throws a Problem, which says what was wrong and what would be right.
#pragma once

#include <algorithm>
#include <cctype>
#include <cstddef>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <curl/curl.h>
#include <nlohmann/json.hpp>

namespace planner_service {

using Json = nlohmann::json;
using Row = std::vector<double>;  // one number for each joint

struct Problem : std::runtime_error {
  Problem(long code, const std::string& detail) : std::runtime_error(detail), status(code) {}
  long status;  // of HTTP; 0 if the server cannot be reached
};

struct State {
  double t;          // seconds since the motion began
  Row q, qd, qdd;    // rad, rad/s, rad/s^2 (m of joints that slide)
};

struct Motion {
  std::string name;
  double begin = 0.0, duration = 0.0;  // seconds of motion before it, and that it takes
  Row t;                               // of the samples, from 0 to the duration
  std::vector<Row> positions, velocities, accelerations;

  // On the quintic through positions, velocities and accelerations of the samples before and after.
  State at(double time) const {
    time = std::clamp(time, 0.0, duration);
    if (t.size() < 2) return {time, positions.at(0), velocities.at(0), accelerations.at(0)};
    const auto after = std::lower_bound(t.begin() + 1, t.end() - 1, time);
    const auto k = static_cast<std::size_t>(after - t.begin()) - 1;
    const double h = t[k + 1] - t[k], x = (time - t[k]) / h;
    State state{time, {}, {}, {}};
    for (std::size_t j = 0; j < positions[k].size(); ++j) {
      const double q0 = positions[k][j], rise = positions[k + 1][j] - q0;
      const double v0 = velocities[k][j] * h, v1 = velocities[k + 1][j] * h;
      const double a0 = accelerations[k][j] * h * h, a1 = accelerations[k + 1][j] * h * h;
      const double c3 = 10 * rise - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1;
      const double c4 = -15 * rise + 8 * v0 + 7 * v1 + 1.5 * a0 - a1;
      const double c5 = 6 * rise - 3 * (v0 + v1) - 0.5 * (a0 - a1);
      state.q.push_back(q0 + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5)))));
      state.qd.push_back((v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / h);
      state.qdd.push_back((a0 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (h * h));
    }
    return state;
  }
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Motion, name, begin, duration, t, positions, velocities, accelerations)

struct GripperEvent {
  double at;                    // seconds of motion before it
  std::string before;           // the motion that follows
  std::optional<double> width;  // metres between the finger pads; none for a gripper that sucks
};

inline void from_json(const Json& json, GripperEvent& event) {
  event = {json.at("at"), json.at("before"), std::nullopt};
  if (json.contains("width")) event.width = json.at("width").get<double>();
}

struct Sampled {
  std::vector<std::string> joint_names;
  std::vector<Motion> motions;
  std::vector<GripperEvent> events;
};

inline void from_json(const Json& json, Sampled& sampled) {
  sampled = {json.at("joint_names"), json.at("motions"), json.at("events")};
}

struct Answer {
  std::string id;  // it stays at /plans/ID
  Json body;
};

class Client {
 public:
  explicit Client(std::string url, std::string token = "")
      : url_(std::move(url)), token_(std::move(token)), curl_(curl_easy_init(), curl_easy_cleanup) {
    if (!curl_) throw Problem(0, "libcurl does not start");
  }

  // A request for work; waits for its answer, a minute at most.
  Answer post(const std::string& path, const Json& body) {
    const std::string text = body.dump();
    return ask(path, &text);
  }

  Answer get(const std::string& path) { return ask(path, nullptr); }

  // The motions of a plan or a task, every dt seconds.
  Sampled trajectory(const std::string& id, double dt = 0.01) {
    return get("/plans/" + id + "/trajectory?format=json&dt=" + std::to_string(dt)).body.get<Sampled>();
  }

 private:
  Answer ask(const std::string& path, const std::string* body) {
    CURL* curl = curl_.get();
    std::string content, place;
    std::unique_ptr<curl_slist, decltype(&curl_slist_free_all)> headers(nullptr, curl_slist_free_all);
    const auto add = [&headers](const std::string& line) {
      headers.reset(curl_slist_append(headers.release(), line.c_str()));
    };
    add("Prefer: wait");
    if (body != nullptr) add("Content-Type: application/json");
    if (!token_.empty()) add("Authorization: Bearer " + token_);
    curl_easy_reset(curl);  // the connection stays open
    curl_easy_setopt(curl, CURLOPT_URL, (url_ + path).c_str());
    curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers.get());
    curl_easy_setopt(curl, CURLOPT_TIMEOUT, 90L);
    if (body != nullptr) curl_easy_setopt(curl, CURLOPT_POSTFIELDS, body->c_str());
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, append);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, &content);
    curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, find_place);
    curl_easy_setopt(curl, CURLOPT_HEADERDATA, &place);
    const CURLcode code = curl_easy_perform(curl);
    if (code != CURLE_OK) throw Problem(0, url_ + path + ": " + curl_easy_strerror(code));
    long status = 0;
    curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status);
    Json json = Json::parse(content, nullptr, false);
    if (status == 202) throw Problem(status, "it takes longer than a minute: " + json.at("id").get<std::string>());
    if (status != 200) throw Problem(status, json.is_object() ? json.value("detail", content) : content);
    return {place, std::move(json)};
  }

  static std::size_t append(char* data, std::size_t size, std::size_t count, void* content) {
    static_cast<std::string*>(content)->append(data, size * count);
    return size * count;
  }

  // The id in the header Content-Location: /plans/ID.
  static std::size_t find_place(char* data, std::size_t size, std::size_t count, void* place) {
    const std::string line(data, size * count), name = "content-location: /plans/";
    const auto same = [](unsigned char a, unsigned char b) { return a == std::tolower(b); };
    if (line.size() > name.size() && std::equal(name.begin(), name.end(), line.begin(), same)) {
      *static_cast<std::string*>(place) = line.substr(name.size(), line.find('\r') - name.size());
    }
    return size * count;
  }

  std::string url_, token_;
  std::unique_ptr<CURL, decltype(&curl_easy_cleanup)> curl_;
};

}  // namespace planner_service
