// Plans 64 anchors past a wall and prints the best: POST /anchors in the binary form.
//
//     g++ -std=c++17 -O2 examples/cpp/anchors.cpp -lcurl -o anchors
//     ./anchors http://127.0.0.1:8000
//
// docs/wire.md describes the form. Numbers are little-endian, as those of x86 and ARM are.
#include <curl/curl.h>

#include <cstdint>
#include <cstring>
#include <iostream>
#include <map>
#include <regex>
#include <stdexcept>
#include <string>
#include <vector>

const std::string kLength = "Inference-Header-Content-Length";

struct Reply {
  long status = 0;
  size_t header_length = 0;  // 0: an error, whose body is JSON
  std::string body;
};

// A request: the JSON header grows with each tensor, and so do the bytes that follow it.
struct Request {
  std::string inputs, data;

  template <class T>
  void add(const std::string& name, const std::string& datatype, const std::string& shape,
           const std::vector<T>& values) {
    const size_t bytes = values.size() * sizeof(T);
    inputs += (inputs.empty() ? "" : ",") + std::string("{\"name\":\"") + name +
              "\",\"datatype\":\"" + datatype + "\",\"shape\":[" + shape +
              "],\"parameters\":{\"binary_data_size\":" + std::to_string(bytes) + "}}";
    data.append(reinterpret_cast<const char*>(values.data()), bytes);
  }

  std::string header(const std::string& parameters) const {
    std::string text = "{\"parameters\":{" + parameters + "},\"inputs\":[" + inputs + "]}";
    return text + std::string((64 - text.size() % 64) % 64, ' ');  // so that tensors are aligned
  }
};

size_t on_header(char* bytes, size_t, size_t count, void* reply) {
  const std::string line(bytes, count);
  if (std::smatch found; std::regex_search(line, found, std::regex(kLength + ": *(\\d+)", std::regex::icase)))
    static_cast<Reply*>(reply)->header_length = std::stoul(found[1]);
  return count;
}

size_t on_body(char* bytes, size_t, size_t count, void* reply) {
  static_cast<Reply*>(reply)->body.append(bytes, count);
  return count;
}

Reply post(CURL* curl, const std::string& url, const std::string& header, const std::string& data) {
  Reply reply;
  const std::string body = header + data;
  curl_slist* lines = curl_slist_append(nullptr, "Content-Type: application/octet-stream");
  lines = curl_slist_append(lines, (kLength + ": " + std::to_string(header.size())).c_str());
  curl_easy_setopt(curl, CURLOPT_URL, (url + "/anchors").c_str());
  curl_easy_setopt(curl, CURLOPT_HTTPHEADER, lines);
  curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE, static_cast<curl_off_t>(body.size()));
  curl_easy_setopt(curl, CURLOPT_POSTFIELDS, body.data());
  curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, on_header);
  curl_easy_setopt(curl, CURLOPT_HEADERDATA, &reply);
  curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, on_body);
  curl_easy_setopt(curl, CURLOPT_WRITEDATA, &reply);
  const CURLcode code = curl_easy_perform(curl);  // the connection stays open for the next one
  curl_slist_free_all(lines);
  if (code != CURLE_OK) throw std::runtime_error(curl_easy_strerror(code));
  curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &reply.status);
  if (reply.status != 200) throw std::runtime_error(reply.body);
  return reply;
}

// The bytes of each tensor by name, in the order in which the header lists them.
std::map<std::string, std::string> tensors_of(const Reply& reply) {
  std::map<std::string, std::string> tensors;
  const std::string header = reply.body.substr(0, reply.header_length);
  const std::regex entry("\"name\": *\"(\\w+)\"[^}]*\"binary_data_size\": *(\\d+)");
  size_t at = reply.header_length;
  for (std::sregex_iterator it(header.begin(), header.end(), entry), end; it != end; ++it) {
    const size_t size = std::stoul((*it)[2]);
    tensors[(*it)[1]] = reply.body.substr(at, size);
    at += size;
  }
  return tensors;
}

template <class T>
std::vector<T> numbers(const std::string& bytes) {
  std::vector<T> values(bytes.size() / sizeof(T));
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

int main(int count, char** arguments) try {
  const std::string url = count > 1 ? arguments[1] : "http://127.0.0.1:8000";
  constexpr int kSide = 64, kAnchors = 64;
  std::vector<float> occupancy(kSide * kSide, 0.0f);  // rows grow with y, columns with x
  for (int row = 20; row < 44; ++row) occupancy[row * kSide + 32] = 1.0f;
  Request request;
  request.add<double>("map_geometry", "FP64", "3", {-5.12, -5.12, 0.16});  // origin, resolution
  request.add<double>("x_curr", "FP64", "6", {-3, 0, 0, 0, 0, 0});  // p, v, a in m and s
  request.add<double>("x_goal", "FP64", "4", {3, 0, 0, 0});         // p, v
  request.add<float>("cost_map", "FP32", "1,64,64", occupancy);
  const std::string parameters = "\"num_samples\":" + std::to_string(kAnchors) + ",\"seed\":0";

  CURL* curl = curl_easy_init();
  const Reply reply = post(curl, url, request.header(parameters), request.data);
  curl_easy_cleanup(curl);
  auto tensors = tensors_of(reply);
  const auto paths = numbers<float>(tensors["trajectories"]);  // [N, T, 2] in m
  const auto scores = numbers<float>(tensors["scores"]);       // [N]
  const auto safe = numbers<uint8_t>(tensors["safe"]);         // [N]
  const size_t steps = paths.size() / scores.size() / 2;
  int best = -1, num_safe = 0;
  for (size_t n = 0; n < scores.size(); ++n) {
    num_safe += safe[n];
    if (safe[n] && (best < 0 || scores[n] > scores[best])) best = static_cast<int>(n);
  }
  std::cout << num_safe << " of " << scores.size() << " anchors are safe\n";
  if (best < 0) return 1;
  for (size_t t = 0; t < steps; t += 9)
    std::cout << paths[2 * (best * steps + t)] << " " << paths[2 * (best * steps + t) + 1] << "\n";
} catch (const std::exception& error) {
  std::cerr << error.what() << "\n";
  return 1;
}
