// Plans a pick-and-place over HTTP, and prints what a controller has to do, one JSON object on each line.
//
//   pick_place http://localhost:8080 [TOKEN]
//
// Lines are {"plan": ID}, then for each motion {"motion": NAME}, {"gripper": METRES} if the gripper moves before it, and
// {"t": SECONDS, "q": [...], "qd": [...], "qdd": [...]} every 2 ms: be at q, in rad, at t since the motion began.

#include <exception>
#include <iostream>
#include <string>

#include "planner_service.hpp"

namespace {

constexpr double TICK = 0.002;  // seconds between two commands to the arm

void print(const planner_service::Json& line) { std::cout << line.dump() << '\n'; }

void print(const planner_service::State& state) {
  print(planner_service::Json{{"t", state.t}, {"q", state.q}, {"qd", state.qd}, {"qdd", state.qdd}});
}

void run(const std::string& url, const std::string& token) {
  planner_service::Client server(url, token);
  const auto [id, task] = server.post(  // the answer leaves the robot out: it is that of GET /robot
      "/pick_place?robot=hash",
      {{"scene", "bin"}, {"target", "blue_block"}, {"onto", "tray"}, {"request", {{"padding", 0.005}}}});
  if (!task.at("ok").get<bool>()) {
    throw planner_service::Problem(200, "no plan: " + task.at("failure").at("detail").get<std::string>());
  }
  print({{"plan", id}});
  const auto sampled = server.trajectory(id);
  for (const auto& motion : sampled.motions) {
    print({{"motion", motion.name}});
    for (const auto& event : sampled.events) {
      if (event.before == motion.name && event.width) print({{"gripper", *event.width}});
    }
    for (int tick = 0; tick * TICK < motion.duration; ++tick) print(motion.at(tick * TICK));
    print(motion.at(motion.duration));
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    run(argc > 1 ? argv[1] : "http://localhost:8080", argc > 2 ? argv[2] : "");
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
}
