// Which requests pass: the defence against other sites' pages, as a table.
#include "app/http_guard.h"

#include <gtest/gtest.h>
#include <string>

namespace lcdm {
namespace {

constexpr const char* kToken = "0123456789abcdef";

int judge(RequestFacts facts, const char* allowed = "GET", const ControlRule& control = {}) {
  if (facts.client.empty()) facts.client = "127.0.0.1";
  return judge_request(facts, allowed, "Depth-Cam", control).status;
}

int get(const char* host) { return judge({"GET", host, ""}); }

TEST(HttpGuard, PassesRequestsToNumericAddressesAndOwnNames) {
  for (const char* host : {"127.0.0.1", "127.0.0.1:8080", "192.168.1.20:80", "[::1]:8080", "[::1]",
                           "localhost:8080", "LOCALHOST", "depth-cam", "DEPTH-CAM.local:8080"}) {
    EXPECT_EQ(get(host), 200) << host;
  }
}

TEST(HttpGuard, RefusesNamesThatAreNotOurs) {
  for (const char* host : {"evil.example", "evil.example:8080", "127.0.0.1.evil.example",
                           "localhost.evil.example", "depth-cam.evil.example", "127.0.0.1:8080x",
                           "[::1", "[::1]x", ":8080", "127.0.0.1:", "127.0.0.1:999999", "[]"}) {
    EXPECT_EQ(get(host), 421) << host;
  }
}

TEST(HttpGuard, RefusesARequestWithoutHost) { EXPECT_EQ(get(""), 400); }

TEST(HttpGuard, AnUnnamedMachineStillHasItsAddress) {
  EXPECT_EQ(judge_request({"GET", "127.0.0.1", ""}, "GET", "", {}).status, 200);
  EXPECT_EQ(judge_request({"GET", ".local", ""}, "GET", "", {}).status, 421);
}

TEST(HttpGuard, TakesOnlyTheMethodOfTheRoute) {
  EXPECT_EQ(judge({"HEAD", "127.0.0.1", ""}), 200) << "HEAD goes wherever GET goes";
  EXPECT_EQ(judge({"POST", "127.0.0.1", ""}), 405);
  EXPECT_EQ(judge({"OPTIONS", "127.0.0.1", ""}), 405);
  EXPECT_EQ(judge({"GET", "127.0.0.1", ""}, "POST"), 405);
  EXPECT_EQ(judge({"HEAD", "127.0.0.1", ""}, "POST"), 405);
}

TEST(HttpGuard, WhatChangesStateMustComeFromOurOwnPage) {
  const auto post = [](const char* host, const char* origin) {
    return judge({"POST", host, origin}, "POST");
  };
  EXPECT_EQ(post("127.0.0.1:8080", "http://127.0.0.1:8080"), 200);
  EXPECT_EQ(post("depth-cam.local", "http://Depth-Cam.local"), 200);
  EXPECT_EQ(post("127.0.0.1:8080", ""), 200) << "not a browser: curl, a script";
  EXPECT_EQ(post("127.0.0.1:8080", "http://127.0.0.1:9090"), 403) << "another port, another site";
  EXPECT_EQ(post("127.0.0.1:8080", "https://127.0.0.1:8080"), 403);
  EXPECT_EQ(post("127.0.0.1:8080", "http://evil.example"), 403);
  EXPECT_EQ(post("127.0.0.1:8080", "null"), 403);
  EXPECT_EQ(post("evil.example", "http://evil.example"), 421) << "a rebound name has no say";
}

// A request that would change something, from this client.
int control(const char* client, const ControlRule& rule, const std::string& authorization = "",
            const char* origin = "") {
  return judge({"POST", "10.0.0.5:8080", origin, client, authorization}, "POST", rule);
}

TEST(HttpGuard, ThisMachineMayControlItself) {
  for (const char* client : {"127.0.0.1", "127.3.2.1", "::1", "::ffff:127.0.0.1"}) {
    EXPECT_EQ(control(client, {}), 200) << client;
    EXPECT_EQ(control(client, {kToken}), 200) << client;
  }
}

TEST(HttpGuard, FromTheNetworkControlIsOffUnlessThereIsAToken) {
  for (const char* client :
       {"192.168.1.7", "10.0.0.5", "fe80::1", "::ffff:10.0.0.9", "", "127.x"}) {
    EXPECT_EQ(judge_request({"POST", "10.0.0.5", "", client}, "POST", "", {}).status, 403)
        << client;
    EXPECT_EQ(judge_request({"GET", "10.0.0.5", "", client}, "GET", "", {}).status, 200)
        << "looking is free: " << client;
  }
  EXPECT_EQ(control("192.168.1.7", {"", true}), 200) << "explicitly insecure";
}

TEST(HttpGuard, TheTokenAndNothingElseOpensControl) {
  const ControlRule rule{kToken};
  const std::string token = kToken;
  EXPECT_EQ(control("192.168.1.7", rule, "Bearer " + token), 200);
  for (const std::string& wrong :
       {std::string(), std::string("Bearer "), token, "Basic " + token, "Bearer " + token + "x",
        "Bearer " + token.substr(1), "Bearer x" + token.substr(1), "bearer" + token}) {
    EXPECT_EQ(control("192.168.1.7", rule, wrong), 401) << wrong;
  }
  EXPECT_EQ(control("192.168.1.7", rule, "Bearer " + token, "http://evil.example"), 403)
      << "another site's page has no use for a token it got";
}

}  // namespace
}  // namespace lcdm
