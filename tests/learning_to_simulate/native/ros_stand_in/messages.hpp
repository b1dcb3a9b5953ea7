// As much of the messages of ROS 2 as the example touches, with their names and types.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace std_msgs::msg {
struct Header {
  double stamp = 0;
  std::string frame_id;
};
struct MultiArrayDimension {
  std::string label;
  std::uint32_t size = 0, stride = 0;
};
struct MultiArrayLayout {
  std::vector<MultiArrayDimension> dim;
  std::uint32_t data_offset = 0;
};
struct Float32MultiArray {
  MultiArrayLayout layout;
  std::vector<float> data;
};
}  // namespace std_msgs::msg

namespace geometry_msgs::msg {
struct Vector3 {
  double x = 0, y = 0, z = 0;
};
struct Point : Vector3 {};
struct Quaternion {
  double x = 0, y = 0, z = 0, w = 1;
};
struct Pose {
  Point position;
  Quaternion orientation;
};
struct Wrench {
  Vector3 force, torque;
};
struct PoseStamped {
  using ConstSharedPtr = std::shared_ptr<const PoseStamped>;
  std_msgs::msg::Header header;
  Pose pose;
};
struct WrenchStamped {
  std_msgs::msg::Header header;
  Wrench wrench;
};
}  // namespace geometry_msgs::msg

namespace sensor_msgs::msg {
struct PointField {
  static constexpr std::uint8_t FLOAT32 = 7;
  std::string name;
  std::uint32_t offset = 0;
  std::uint8_t datatype = 0;
  std::uint32_t count = 0;
};
struct PointCloud2 {
  std_msgs::msg::Header header;
  std::uint32_t height = 0, width = 0;
  std::vector<PointField> fields;
  bool is_bigendian = false;
  std::uint32_t point_step = 0, row_step = 0;
  std::vector<std::uint8_t> data;
  bool is_dense = false;
};
}  // namespace sensor_msgs::msg

namespace grid_map_msgs::msg {
struct GridMapInfo {
  double resolution = 0, length_x = 0, length_y = 0;
  geometry_msgs::msg::Pose pose;
};
struct GridMap {
  std_msgs::msg::Header header;
  GridMapInfo info;
  std::vector<std::string> layers, basic_layers;
  std::vector<std_msgs::msg::Float32MultiArray> data;
  std::uint16_t outer_start_index = 0, inner_start_index = 0;
};
}  // namespace grid_map_msgs::msg

namespace diagnostic_msgs::msg {
struct DiagnosticStatus {
  static constexpr std::uint8_t OK = 0, WARN = 1, ERROR = 2, STALE = 3;
  std::uint8_t level = OK;
  std::string name, message, hardware_id;
};
struct DiagnosticArray {
  std_msgs::msg::Header header;
  std::vector<DiagnosticStatus> status;
};
}  // namespace diagnostic_msgs::msg
