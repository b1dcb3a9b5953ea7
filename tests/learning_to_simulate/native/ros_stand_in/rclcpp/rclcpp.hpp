// A stand-in for rclcpp: poses come from standard input (x y z qw qx qy qz), one a frame; what is
// published is printed.
#pragma once
#include <chrono>
#include <cstdio>
#include <cstring>
#include <functional>
#include <memory>
#include <string>

#include "../messages.hpp"

namespace rclcpp {
inline void print(const geometry_msgs::msg::WrenchStamped &m) {
  const auto &f = m.wrench.force, &t = m.wrench.torque;
  std::printf("wrench %.9g %.9g %.9g %.9g %.9g %.9g\n", f.x, f.y, f.z, t.x, t.y, t.z);
}
inline void print(const sensor_msgs::msg::PointCloud2 &m) {
  float p[3];
  std::memcpy(p, m.data.data() + m.point_step * (m.width - 1), sizeof p);
  std::printf("cloud %u %zu %.9g %.9g %.9g\n", m.width, m.data.size(), p[0], p[1], p[2]);
}
inline void print(const grid_map_msgs::msg::GridMap &m) {
  std::printf("map %.9g %.9g %.9g %u %u", m.info.resolution, m.info.pose.position.x,
              m.info.pose.position.y, m.data[0].layout.dim[1].size, m.data[0].layout.dim[0].size);
  for (float h : m.data[0].data) std::printf(" %.9g", h);
  std::printf("\n");
}
inline void print(const diagnostic_msgs::msg::DiagnosticArray &m) {
  std::printf("status %d %s\n", m.status[0].level, m.status[0].message.c_str());
}

struct TimerBase {
  using SharedPtr = std::shared_ptr<TimerBase>;
  std::function<void()> call;
};
template <class M>
struct Subscription {
  using SharedPtr = std::shared_ptr<Subscription>;
};
template <class M>
struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(const M &message) { print(message); }
};

inline std::function<void(std::shared_ptr<const geometry_msgs::msg::PoseStamped>)> listener;
inline std::shared_ptr<TimerBase> timer;

class Node {
 public:
  explicit Node(const std::string &) {}
  double now() const { return 0; }
  template <class M, class F>
  typename Subscription<M>::SharedPtr create_subscription(const std::string &, int, F call) {
    listener = call;
    return std::make_shared<Subscription<M>>();
  }
  template <class M>
  typename Publisher<M>::SharedPtr create_publisher(const std::string &, int) {
    return std::make_shared<Publisher<M>>();
  }
  template <class F>
  TimerBase::SharedPtr create_wall_timer(std::chrono::duration<double>, F call) {
    timer = std::make_shared<TimerBase>();
    timer->call = call;
    return timer;
  }
};

inline void init(int, char **) {}
inline void shutdown() {}
inline void spin(std::shared_ptr<Node>) {
  auto m = std::make_shared<geometry_msgs::msg::PoseStamped>();
  auto &p = m->pose.position;
  auto &q = m->pose.orientation;
  while (std::scanf("%lf %lf %lf %lf %lf %lf %lf", &p.x, &p.y, &p.z, &q.w, &q.x, &q.y, &q.z) == 7) {
    listener(m);
    timer->call();
  }
}
}  // namespace rclcpp
