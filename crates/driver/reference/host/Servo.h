// Just enough of Arduino to run a sketch on a host: the serial port is standard input and output, and what a servo is told goes to
// standard error, "PIN MICROSECONDS" or "PIN off" a line.
#pragma once
#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

inline unsigned long millis() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(steady_clock::now().time_since_epoch()).count();
}

struct HostSerial {
  void begin(long) {}
  int available() {
    pollfd input = {0, POLLIN, 0};
    return poll(&input, 1, 1) > 0;
  }
  int read() {
    char next;
    if (::read(0, &next, 1) != 1) exit(0);  // The one who asked has gone.
    return next;
  }
  void print(const std::string &text) {
    if (write(1, text.data(), text.size()) < 0) exit(0);
  }
  void print(char letter) { print(std::string(1, letter)); }
  void print(long number) { print(std::to_string(number)); }
  void print(int number) { print(std::to_string(number)); }
  void println(const std::string &text) { print(text + "\r\n"); }
};
static HostSerial Serial;

struct Servo {
  int pin = 0;
  void attach(int to) { pin = to; }
  void detach() { fprintf(stderr, "%d off\n", pin); }
  void writeMicroseconds(int us) { fprintf(stderr, "%d %d\n", pin, us); }
};
