// One face for Embree 3 and Embree 4: how single rays and packets are asked for.
#pragma once

#if EMBREE == 3
#include <embree3/rtcore.h>
#elif EMBREE == 4 && __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include "embree4.hpp"
#endif

// What goes with every question: these rays are neighbours.
#if EMBREE == 3
struct Query {
    RTCIntersectContext context;

    Query()
    {
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    }
};
#define ASK(function, rays) function(scene, &query.context, rays)
#define ASK_SOME(function, rays) function(valid, scene, &query.context, rays)
#else
struct Query {
    RTCIntersectArguments arguments;

    Query()
    {
        rtcInitIntersectArguments(&arguments);
        arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
    }
};
#define ASK(function, rays) function(scene, rays, &query.arguments)
#define ASK_SOME(function, rays) function(valid, scene, rays, &query.arguments)
#endif

// Finds the nearest hit of each ray whose `valid` is -1.
inline void nearest(const int*, RTCScene scene, Query& query, RTCRayHit& rays) { ASK(rtcIntersect1, &rays); }
inline void nearest(const int* valid, RTCScene scene, Query& query, RTCRayHit8& rays) { ASK_SOME(rtcIntersect8, &rays); }
inline void nearest(const int* valid, RTCScene scene, Query& query, RTCRayHit16& rays) { ASK_SOME(rtcIntersect16, &rays); }

// Makes `tfar` negative where anything lies on a ray.
inline void blocked(const int*, RTCScene scene, Query& query, RTCRay& rays) { ASK(rtcOccluded1, &rays); }
inline void blocked(const int* valid, RTCScene scene, Query& query, RTCRay8& rays) { ASK_SOME(rtcOccluded8, &rays); }
inline void blocked(const int* valid, RTCScene scene, Query& query, RTCRay16& rays) { ASK_SOME(rtcOccluded16, &rays); }
